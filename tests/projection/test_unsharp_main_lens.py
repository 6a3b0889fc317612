"""A main lens that is not sharp: weights against integrals over the aperture, against each other, and transposed."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import projected_point, small_camera
from oracles.unsharp_light import unsharp_point_image

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid((-0.0761, -0.0483, -2.213), (0.0385, 0.041, 1.03), (5, 6, 5))
POINTS = ((0.05, -0.03, -4.0), (0.003, 0.002, -0.4), (0.11, -0.07, 0.0), (0.05, -0.03, 1.0), (0.11, -0.07, 3.0))


def unsharp(blur_mm, kind="square", **options):
    return replace(small_camera(kind, offset_mm=(0.013, -0.027), **options), blur_mm=blur_mm)


def own_light(camera, where, point):
    """The oracle's light of the pixels that lie under their own microlens alone, and which those are."""
    inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= camera.aperture_radius_px
    return decode(unsharp_point_image(camera, point), where).values.astype(float), inner


@pytest.mark.parametrize("blur_mm", [0.008, 0.02, 0.04])
def test_exact_weights_are_the_light(blur_mm):
    """A pixel away from the rim to 0.8 % of the brightest, and light misplaced in all to 1.3 %."""
    camera = unsharp(blur_mm)
    where = layout(camera)
    for point in POINTS:
        want, inner = own_light(camera, where, point)
        off = np.abs(projected_point(where, point, "polygons") - want)
        assert off[inner].max() <= 0.008 * want.max()
        assert off.sum() <= 0.013 * want.sum()


@pytest.mark.parametrize("blur_mm", [0.008, 0.02, 0.04])
def test_maps_are_the_light(blur_mm):
    camera = unsharp(blur_mm)
    where = layout(camera)
    for point in POINTS:
        want, _ = own_light(camera, where, point)
        usual, fine = (
            np.abs(projected_point(where, point, "exact", 0.017, across=across) - want).sum() / want.sum()
            for across in (7.0, 40.0)
        )
        assert usual <= 0.04
        assert fine <= 0.013


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_without_blur_nothing_is_convolved_and_a_little_changes_little(kind):
    where = layout(unsharp(0.0, kind))
    little = layout(unsharp(0.0005, kind))
    for point in POINTS[::2]:
        sharp, blurred = (projected_point(each, point) for each in (where, little))
        assert np.abs(sharp - blurred).sum() < 0.06 * sharp.sum()
    projector = PlenopticProjector(where, GRID)
    assert projector.images.camera.blurred.size == 0


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_light_is_conserved(kind):
    """Whatever the blur, all views together collect the same of a voxel, within what rim pixels are taken as."""
    for z in (-3.0, 0.0, 1.5):
        sharp, wide = (projected_point(layout(unsharp(b, kind)), (0.02, 0.01, z)).sum() for b in (0.0, 0.03))
        assert wide == pytest.approx(sharp, rel=0.01)


@pytest.mark.parametrize("weights", ["exact", "polygons"])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_gather_is_the_transpose_of_forward(kind, weights):
    projector = PlenopticProjector(layout(unsharp(0.03, kind, pmr=8, microlenses=(15, 13))), GRID, weights)
    rng = np.random.default_rng(3)
    volume = projector.every_voxel().with_values(rng.random(GRID.size).astype(np.float32))
    light = np.repeat(projector.light_of_planes(), GRID.shape[1] * GRID.shape[2]).astype(float)
    for view in (0, 3, projector.views // 2):
        image = np.where(projector.seen[view], rng.random(projector.seen.shape[1]), 0).astype(np.float32)
        forward = projector.forward(view, volume).astype(float) @ image
        back = (projector.gather(view, image, volume) * light) @ volume.values
        assert forward == pytest.approx(back, rel=1e-5)
        assert forward > 0


def test_no_light_reaches_the_equations_of_a_tile_from_beyond_it():
    grid = VoxelGrid((-0.2, -0.35, -1.0), (0.04, 0.035, 0.5), (5, 21, 11))
    projector = PlenopticProjector(layout(unsharp(0.03)), grid)
    tile = projector.tile(4, 17)
    values = np.ones(grid.shape, np.float32)
    values[:, 4:17] = 0
    beyond = projector.every_voxel().with_values(values.ravel())
    light = projector.forward(np.arange(projector.views), beyond)
    assert tile.seen.sum() > 300
    assert np.abs(light[tile.seen]).max() <= 1e-4 * light.max()


def test_the_voxel_of_a_particle_stays_a_candidate_and_most_others_do_not():
    camera = unsharp(0.02, microlenses=(21, 19))
    where, point = layout(camera), (0.02, -0.03, 1.0)
    grid = VoxelGrid((-0.302, -0.302, -1.0), (0.0175, 0.0175, 0.2), (21, 35, 35))
    image = 2e5 * unsharp_point_image(camera, point)
    values = decode(image, where).values
    volume = PlenopticProjector(where, grid).candidates(values + 20, 1e5)
    found = np.argwhere(volume.mask()) * grid.voxel_mm[::-1] + grid.first_mm[::-1]
    assert np.abs(found - point[::-1]).max(1).min() < 0.1
    assert 0 < len(found) < 0.05 * grid.size


def test_rays_refuse_a_blur():
    chain = Chain((unsharp(0.02),), GRID, ReconstructionSettings(weights="9-rays"))
    with pytest.raises(PlenoPIVError, match=r'weights: "9-rays" .* use "exact", or main_lens.blur_mm = 0'):
        _ = chain.projection
