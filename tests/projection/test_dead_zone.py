"""Where a point's depth cannot be told, found by scanning z in voxel steps, against the closed forms of DESIGN
section 2."""

import numpy as np
import pytest
from oracles.cameras import projected_point, small_camera
from oracles.naive_projection import exact_light

from plenopiv.lightfield import layout

pytestmark = pytest.mark.usefixtures("one_thread")

MICROLENSES = (5, 5)


def lenses_lit(where, z):
    """Microlenses that send light of a point on the axis to a pixel of theirs."""
    return np.count_nonzero(exact_light(where, (0.0, 0.0, z)).any(0))


def lenses_in_projection(where, z):
    return np.count_nonzero(projected_point(where, (0.0, 0.0, z)).any(0))


@pytest.mark.parametrize("magnification", [pytest.param(-1.0, marks=pytest.mark.full), -0.5])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_point_centred_on_a_microlens_first_lights_a_second_one(magnification, side):
    # at 13 pixels a microlens whole pixels touch the rim on the axis; at 14 the light's first pixel is half lit, unseen
    camera = small_camera("square", pmr=13.0, microlenses=MICROLENSES, magnification=magnification)
    voxel = camera.lattice.pitch_mm / (2 * abs(magnification))
    limit = camera.dead_zone_mm()[0 if side < 0 else 1]
    where = layout(camera)
    by_light = next(z for z in side * voxel / 2 * np.arange(1, 200) if lenses_lit(where, z) > 1)
    by_projector = next(z for z in side * voxel / 2 * np.arange(1, 200) if lenses_in_projection(where, z) > 1)

    print(
        f"\nM = {magnification}: {limit:+.3f} mm; light {by_light:+.3f}, projector {by_projector:+.3f}, "
        f"voxel {voxel:.4f}"
    )
    assert abs(by_light - limit) <= voxel
    assert abs(by_projector - limit) <= voxel


@pytest.mark.parametrize("magnification", [-1.0, -0.5])
def test_share_of_positions_without_depth(magnification):
    """(1 - |z|/z0)^2 on a square lattice: the blur fits into the cell only where its centre keeps off the sides."""
    camera = small_camera("square", magnification=magnification)
    pitch, radius = camera.lattice.pitch_mm, 0.5 * camera.main_lens.aperture_mm
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    u, v = radius * np.cos(angle), radius * np.sin(angle)
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 4000)) * pitch / magnification
    for side, z0 in zip((-1, 1), np.abs(camera.dead_zone_mm()), strict=True):
        for fraction in (0.0, 0.25, 0.5, 0.75, 1.0):
            z = side * fraction * z0
            a, b = float(camera.spread(z)), float(camera.scale(z))
            i, j = camera.lattice.nearest(a * u + b * x[:, None], a * v + b * y[:, None])
            alone = ((i == i[:, :1]) & (j == j[:, :1])).all(1)
            assert alone.mean() == pytest.approx((1 - fraction) ** 2, abs=0.025)
