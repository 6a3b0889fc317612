"""Particles beside the volume, which light its pixels: they are found, take their own light, and are not reported."""

import numpy as np
import pytest
import xarray
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded

from plenopiv.run.track_frame import around, beside, own_tracks, spread_mm
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.light import PointLights
from plenopiv.volume import VoxelGrid, within

LIGHT = GAIN * 400.0 * 150.0
GRID = VoxelGrid.covering(*LIMITS, tuple(VOXEL_MM))
WIDE = ((-0.7, 0.7), (-0.7, 0.7), (-2.5, 2.5))  # the sensor sees 0.6 mm to each side in focus


@pytest.fixture(scope="module")
def of_points():
    return PointLights(CAMERA)


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_a_particle_that_sheds_a_quarter_of_its_light_on_the_sensor_is_found(of_points, axis, sign):
    place = np.array([[0.05, 0.05, 2.2]])
    place[0, axis] = sign * 0.68
    seen = float(of_points(place).whole()[0])
    assert 0.15 < seen < 0.4
    pixels = pixels_of(noisy(place, np.array([60_000.0])))
    excess = (pixels.counts - 2.0) / np.sqrt(pixels.variance(np.full(len(pixels.counts), 2.0)))
    found, score = of_points.places(excess, ((-0.9, 0.9), (-0.9, 0.9), (-2.5, 2.5)))
    assert score[0] > 15.0
    assert (np.abs(found[0] - place[0]) < (0.06, 0.06, 0.8)).all()


def test_the_light_of_particles_beside_the_volume_loses_none_within(of_points):
    ghosts, missed, count, errors = np.zeros(2), np.zeros(2), 0, ([], [])
    for seed, ppm in ((3, 0.8), (4, 0.4), (5, 0.4)):
        truth = seeded(ppm, seed, WIDE)
        own = within(truth.position_mm, LIMITS)
        count += own.sum()
        pixels = pixels_of(noisy(truth.position_mm, truth.electrons, seed))
        start = truth.position_mm[own] + 0.3 * VOXEL_MM
        for k, limits in enumerate((around(GRID), beside(GRID, spread_mm(CAMERA, GRID)))):
            found = particles_of_frame(of_points, pixels, start, np.full(len(start), LIGHT), limits)
            found = found.of(within(found.position_mm, LIMITS))
            partner = nearest(truth.position_mm, found.position_mm)
            ghosts[k] += (~np.isin(np.arange(len(found.light)), partner)).sum()
            missed[k] += (partner[own] < 0).sum()
            both = partner >= 0
            errors[k].append((found.position_mm[partner[both]] - truth.position_mm[both]) / VOXEL_MM)
    near, wide = (np.std(np.concatenate(each), axis=0) for each in errors)
    assert ghosts[1] <= 0.04 * count
    assert missed[1] < 0.05 * count
    assert missed[1] < 0.3 * missed[0]
    assert (wide < 0.8 * near).all()


def test_limits_reach_as_far_as_light_of_the_volume_spreads_in_the_focal_plane():
    near, far = around(GRID), beside(GRID, spread_mm(CAMERA, GRID))
    assert far[2] == near[2]
    spread = 12.5 * near[2][1] / 100.0  # half the aperture, 100 mm before the lens
    for (lo, hi), (low, high) in zip(near[:2], far[:2], strict=True):
        assert (low, high) == pytest.approx((lo - spread, hi + spread))
    assert near[0] == pytest.approx((GRID.limits_mm()[0][0] - 0.068, GRID.limits_mm()[0][1] + 0.068))


def test_tracks_beside_the_volume_are_not_reported():
    place = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.4, 0.0, 0.0], [0.0, 0.0, 2.7]])
    tracks = xarray.Dataset({axis: ("obs", place[:, k]) for k, axis in enumerate("xyz")}, attrs={"dt_s": 1.0})
    tracks["track_id"] = ("obs", np.arange(5))
    kept = own_tracks(tracks, GRID)
    assert kept.track_id.values.tolist() == [0, 3, 4]  # within four voxels of the volume
    assert kept.attrs == {"dt_s": 1.0}
