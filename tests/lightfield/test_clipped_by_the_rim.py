"""Light that the rim of the main lens takes from pixels: its area, its signs, and its place in the weights."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.calibration import find_lattice
from plenopiv.cameras.plenoptic import LensRim
from plenopiv.lightfield import LIT_SHARE, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "calibration"))

from random_cameras import RandomCamera, draw

RIM = LensRim(13.0, -18.0, (0.9, -0.6))  # matched apertures here are 25 mm wide, the sensor's corner at 0.6 mm
GRID = VoxelGrid((-0.2, -0.15, -2.0), (0.04, 0.04, 1.0), (5, 8, 10))


@pytest.fixture(params=["square", "hexagonal"])
def camera(request):
    return replace(small_camera(request.param, offset_mm=(0.01, -0.004), rotation_rad=0.01), rim=RIM)


def test_light_is_the_area_in_both_discs_over_that_in_the_aperture(camera):
    """By points of each pixel: u on the main lens is (m - phase_c, phase_r - n) portions."""
    where = layout(camera)
    d = (np.arange(40) + 0.5) / 40 - 0.5
    rng, worst = np.random.default_rng(2), []
    j, i = np.divmod(np.arange(where.lenses), where.ni)
    s, t = camera.lattice.centres(i + where.i0, j + where.j0)
    pixels = np.argwhere(where.seen)
    for view, lens in pixels[rng.choice(len(pixels), 400, replace=False)]:
        m, n = where.offsets[view]
        u = (m - where.phase[lens, 0] + d) * camera.portion_mm
        v = (where.phase[lens, 1] - n + d[:, None]) * camera.portion_mm
        inside = u**2 + v**2 < (0.5 * camera.main_lens.aperture_mm) ** 2
        x, y = RIM.slip * s[lens] + RIM.start_mm[0], RIM.slip * t[lens] + RIM.start_mm[1]
        left = inside & ((u - x) ** 2 + (v - y) ** 2 < RIM.radius_mm**2)
        worst.append(abs(left.sum() / inside.sum() - where.light[view, lens]))
    assert np.max(worst) < 0.12  # where both edges cross one pixel
    assert np.mean(worst) < 0.006
    assert (where.light[where.seen] < 0.9).sum() > 100


def test_pixels_that_the_rim_leaves_little_light_are_no_equations(camera):
    where, whole = layout(camera), layout(replace(camera, rim=None))
    views = [np.flatnonzero((whole.offsets == offset).all(1))[0] for offset in where.offsets]
    assert whole.seen.sum() > 1.03 * where.seen.sum()
    assert not (where.seen & ~whole.seen[views]).any()
    assert (where.light * where.fill)[where.seen].min() >= LIT_SHARE


def test_a_rim_that_clips_nothing_changes_nothing(camera):
    wide, without = layout(replace(camera, rim=replace(RIM, radius_mm=40.0))), layout(replace(camera, rim=None))
    assert wide.light is None
    np.testing.assert_array_equal(wide.seen, without.seen)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("weights", ["exact", "polygons"])
def test_views_get_their_light_and_give_back_as_much(camera, weights):
    where = layout(camera)
    bare = replace(where, light=None)
    projectors = [PlenopticProjector(each, GRID, weights) for each in (where, bare)]
    volume, views = projectors[0].every_voxel(), np.arange(where.views)
    clipped, whole = (each.forward(views, volume) for each in projectors)
    light = np.where(where.seen, where.light, 0)
    np.testing.assert_allclose(clipped, whole * light, atol=2e-5 * whole.max())
    image = np.random.default_rng(1).random(whole.shape).astype(np.float32) * where.seen
    back = projectors[0].gather(views, image, volume)
    np.testing.assert_allclose(back, projectors[1].gather(views, image * light, volume), rtol=2e-4)


def test_a_voxel_that_a_pixel_sees_by_a_little_light_is_not_ruled_out_by_it(camera):
    """Every pixel holds half of what the voxel's particle would send it through an open lens; clipped to less than half
    of that, pixels cannot rule it out."""
    where = layout(camera)
    counts = np.full(where.seen.shape, 1.0, np.float32)
    particle = 5000.0
    kept = [PlenopticProjector(each, GRID).candidates(counts, particle).values.size for each in
            (where, replace(where, light=None), replace(where, light=np.full_like(where.light, 1e-3)))]  # fmt: skip
    assert kept[1] <= kept[0] < kept[2]


@pytest.mark.full
def test_the_white_image_tells_the_light():
    """A drawn cat's eye: the rim found explains the light of every pixel, with its signs."""
    of = RandomCamera(
        "hexagonal", 420, 14.3, 1.0, (3.0, -2.0), 0.0, 0.0, 0j, 0j, 0.97, 1.1, 0.6, 0.4, 0.0, (0.12, -0.08), (0.0, 0.0),
        0.0, 4000.0, 3.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 1.0, 1.0, 5,
    )  # fmt: skip
    camera, white = draw(of)
    fit = find_lattice(white, camera)
    where = layout(replace(camera.with_lattice(fit.lattice), rim=fit.rim))
    light = decode(white.astype(float), where).values / (4000.0 / 2.5)
    expected = where.fill * where.light
    off = light[where.seen] - expected[where.seen]
    assert np.sqrt(np.mean(off**2)) < 0.07
    assert abs(np.mean(off)) < 0.02
    clipped = where.seen & (where.light < 0.9)
    assert clipped.sum() > 500
    assert np.corrcoef(light[clipped], expected[clipped])[0, 1] > 0.8
