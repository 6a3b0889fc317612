"""Seeding: density, uniformity, light."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.presets import preset
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles, particle_count, pixels_lit_in_focus, seed_box

CAMERA = preset("29mp")
BOX = ((-2.0, 3.0), (-1.0, 1.0), (-4.0, 4.0))


def test_ppm_counts_the_lenses_that_cover_the_field():
    field = ((-4.45, 4.45), (-3.2125, 3.2125), (-4.0, 4.0))
    lenses = 8.9 * 6.425 / (0.077**2 * np.sqrt(3) / 2)
    assert particle_count(CAMERA, field, 1.0) == round(lenses) == 11137
    # at M = -0.5 the same field is imaged on a quarter of them
    half = replace(CAMERA, main_lens=replace(CAMERA.main_lens, magnification=-0.5))
    assert particle_count(half, field, 2.0) == round(2.0 * lenses / 4)


def test_positions_fill_the_box_evenly():
    p = seed_box(CAMERA, BOX, 5.0, np.random.default_rng(1), electrons=100.0)
    lo, hi = np.array(BOX).T
    assert (p.position_mm >= lo).all()
    assert (p.position_mm <= hi).all()
    standard = (p.position_mm - lo) / (hi - lo)
    n = len(standard)
    assert standard.mean(0) == pytest.approx([0.5] * 3, abs=4 / np.sqrt(12 * n))
    assert standard.var(0) == pytest.approx([1 / 12] * 3, abs=4 / np.sqrt(180 * n))


def test_light_per_pixel_is_what_a_particle_in_focus_gives():
    camera = preset("pmr14")
    p = seed_box(camera, ((-0.1, 0.1),) * 3, 1.0, np.random.default_rng(0), electrons_per_pixel=400.0)
    assert p.electrons == pytest.approx(400.0 * pixels_lit_in_focus(camera))
    image = particle_image(camera, p.moved_to(np.zeros_like(p.position_mm)), rays=500_000)
    assert np.median(image[image > 0.9 * image.max()]) == pytest.approx(400.0 * len(p.electrons), rel=0.02)


def test_spread_is_relative_and_keeps_the_mean():
    p = seed_box(CAMERA, BOX, 10.0, np.random.default_rng(2), electrons=1000.0, electrons_spread=0.25)
    assert p.electrons.mean() == pytest.approx(1000.0, rel=0.01)
    assert p.electrons.std() == pytest.approx(250.0, rel=0.03)
    assert p.electrons.min() > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"limits_mm": ((1, -1), (-1, 1), (-1, 1))}, "x limits"),
        ({"particles_per_microlens": 0.0}, "particles_per_microlens"),
        ({"electrons": None}, "give one of"),
        ({"electrons_spread": -1.0}, "electrons_spread"),
        ({"particles_per_microlens": 1e-9}, "none in this box"),
    ],
)
def test_bad_seeding_is_named(change, message):
    good = {"limits_mm": BOX, "particles_per_microlens": 1.0, "electrons": 1.0, "rng": np.random.default_rng(0)}
    with pytest.raises(PlenoPIVError, match=message):
        seed_box(CAMERA, **(good | change))


def test_bad_particles_are_named():
    with pytest.raises(PlenoPIVError, match="shape"):
        Particles(np.zeros((3, 2)), np.ones(3))
    with pytest.raises(PlenoPIVError, match="finite"):
        Particles(np.full((3, 3), np.nan), np.ones(3))
