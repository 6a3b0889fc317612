"""Weights of an array that a map moves off the regular lattice: views, maps of planes and sums voxel by voxel."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light

from plenopiv.errors import PlenoPIVWarning
from plenopiv.lattice import LatticeMap
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid((-0.0761, -0.0483, -2.213), (0.0385, 0.041, 1.03), (5, 2, 3))
# up to a pitch and a half (66 um) at the sensor's corner, 0.39 mm from the axis; 5 % of the distance near it
UP_TO_2 = (0.012, 0.01), (-0.008, -0.015), (0.01, 0.0), (0.0, 0.02), (0.01, 0.0)
BY = LatticeMap(3, 0.25, (*UP_TO_2, *((0.01, 0.008),) * 4))


def distorted(kind, **options):
    camera = small_camera(kind, pmr=8, microlenses=(13, 12), offset_mm=(0.007, -0.004), **options)
    return camera.with_lattice(replace(camera.lattice, map=BY))


def inner_views(where):
    """The layout with those views only that the aperture's rim does not cut."""
    inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= where.camera.aperture_radius_px
    return replace(where, seen=where.seen & inner[:, None]), np.flatnonzero(inner)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_pixels_are_where_the_micro_images_are(kind):
    camera = distorted(kind, rotation_rad=1.2)
    with pytest.warns(PlenoPIVWarning, match="rows of microlenses are turned"):
        where = layout(camera)
    lattice, sensor = where.camera.lattice, camera.sensor
    assert lattice.rotation_rad != 1.2  # numbered along other rows
    j, i = np.mgrid[where.j0 : where.j0 + where.nj, where.i0 : where.i0 + where.ni]
    s, t = lattice.centres(i.ravel(), j.ravel())
    e = camera.image_scale
    centre = np.stack(sensor.pixel_from_plane(s * (1 + e), t * (1 + e)), -1)
    np.testing.assert_allclose(where.pixel + where.phase, centre, atol=1e-5)
    assert np.abs(where.phase).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("weights", ["polygons", "exact"])
def test_light_of_every_voxel_against_plain_python(kind, weights):
    """Forward and back. Maps of planes interpolate, which is some hundredths of the largest share."""
    where, views = inner_views(layout(distorted(kind)))
    projector = PlenopticProjector(where, GRID, weights, across=40.0)
    x, y, z = GRID.axes()
    naive = np.array([exact_light(where, (px, py, pz)) for pz in z for py in y for px in x])
    assert (naive.sum((1, 2)) > 0.3).all()
    rng = np.random.default_rng(5)
    values = rng.random(GRID.size).astype(np.float32) + np.float32(0.1)
    volume = projector.every_voxel().with_values(values)
    got = np.array([projector.forward(v, volume) for v in range(projector.views)])
    want = np.tensordot(values.astype(float), naive, 1)
    image = rng.normal(size=want.shape).astype(np.float32) * where.seen
    back = sum(projector.gather(v, image[v], volume).astype(float) for v in views)
    light = np.repeat(projector.light_of_planes().astype(float), GRID.shape[1] * GRID.shape[2])
    want_back = np.tensordot(naive / light[:, None, None], image.astype(float), 2)
    for a, b in ((got, want), (back, want_back)):
        np.testing.assert_allclose(a, b, rtol=0, atol=(3e-5 if weights == "polygons" else 0.1) * np.abs(b).max())
        assert np.std(a - b) < 0.05 * np.std(b)


@pytest.mark.parametrize("weights", ["1-ray", "9-rays", "polygons", "exact"])
def test_a_map_that_moves_nothing_changes_nothing(weights):
    camera = small_camera("hexagonal", pmr=8, microlenses=(9, 8), rotation_rad=0.02, offset_mm=(0.007, -0.004))
    still = LatticeMap(2, 1.0, ((0.0, 0.0),) * 5)
    images = []
    for each in (camera, camera.with_lattice(replace(camera.lattice, map=still))):
        projector = PlenopticProjector(layout(each), GRID, weights)
        images.append(projector.forward(np.arange(projector.views), projector.every_voxel()))
    np.testing.assert_allclose(*images, atol=2e-5 * images[0].max())
