"""Voxels' shadows on pinhole cameras: against a loop over pixels, against the cube itself, as transposes."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from oracles.tomography import SCALE_MM_PX, cubes, four_cameras, shadow_shares

from plenopiv.cameras.pinhole import looking_at
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.pinhole.projector import PinholeProjector, pinhole_constants
from plenopiv.sensor import Sensor
from plenopiv.volume import SparseVolume

BENT = [replace(c, distortion=(0.2, -0.1), principal_point_px=(10.0, 12.5)) for c in four_cameras(20)]
SETTINGS = {
    "cubes": (four_cameras(20), cubes(12, 11, 5)),
    "bent": (BENT, cubes(9, 8, 6)),
    "wide": (four_cameras(20), cubes(6, 5, 4, (0.2, 0.15, 0.3))),  # shadows over several pixels
    "narrow": (four_cameras(20), cubes(12, 9, 8, (0.02, 0.03, 0.01))),
    "over the edge": (four_cameras(10), cubes(16, 17, 4)),
}


def random_volume(grid, share=0.6, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(grid, rng.random(grid.shape) < share)
    return volume.with_values(rng.uniform(1, 100, volume.column.size).astype(np.float32))


def listed(volume):
    return np.flatnonzero(volume.with_values(np.ones_like(volume.values)).dense().values)


@pytest.mark.parametrize("setting", SETTINGS)
def test_images_are_those_of_the_slow_loop(setting):
    cameras, grid = SETTINGS[setting]
    projector, volume = PinholeProjector(cameras, grid), random_volume(grid)
    images = projector.forward(np.arange(4), volume)
    for camera, image in zip(cameras, images, strict=True):
        expected = shadow_shares(camera, grid) @ volume.dense().values.ravel().astype(float)
        np.testing.assert_allclose(image, expected, atol=2e-6 * expected.max())
    assert images.shape == projector.seen.shape == (4, cameras[0].sensor.rows * cameras[0].sensor.columns)


@pytest.mark.parametrize("setting", SETTINGS)
def test_voxels_gather_what_the_slow_loop_says(setting):
    cameras, grid = SETTINGS[setting]
    projector, volume = PinholeProjector(cameras, grid), random_volume(grid)
    images = np.random.default_rng(1).normal(size=projector.seen.shape).astype(np.float32)
    expected = sum(shadow_shares(c, grid).T @ i.astype(float) for c, i in zip(cameras, images, strict=True))
    np.testing.assert_allclose(projector.gather(np.arange(4), images, volume), expected[listed(volume)], atol=5e-6)


@pytest.mark.parametrize("setting", SETTINGS)
def test_forward_and_back_are_transposes(setting):
    cameras, grid = SETTINGS[setting]
    projector, volume = PinholeProjector(cameras, grid), random_volume(grid)
    for view in range(4):
        y = np.random.default_rng(view).normal(size=projector.pixels[view]).astype(np.float32)
        ax, back = projector.forward(view, volume).astype(float), projector.gather(view, y, volume).astype(float)
        sizes = np.linalg.norm(ax) * np.linalg.norm(y)
        assert sizes > 0
        assert abs(ax @ y - volume.values.astype(float) @ back) <= 1e-6 * sizes


def test_all_of_a_voxel_s_light_arrives():
    grid = cubes(12, 11, 5)
    projector, volume = PinholeProjector(four_cameras(20), grid), random_volume(grid)
    total = volume.values.sum(dtype=float)
    assert projector.forward(np.arange(4), volume).sum(1, dtype=float) == pytest.approx([total] * 4, rel=1e-6)


@pytest.mark.parametrize("voxel_mm", [(0.074, 0.074, 0.074), (0.074, 0.074, 0.2)])
def test_the_square_is_as_wide_as_the_box_s_shadow(voxel_mm):
    """Points strewn evenly in a voxel: mean and variance of their images are the square's, in a turned camera."""
    camera, grid = four_cameras(64, 25.0)[3], cubes(1, 1, 1, voxel_mm)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (400_000, 3)) * voxel_mm
    pixels = camera.project(points)
    cam = pinhole_constants(camera, grid)
    assert pixels.mean(0) == pytest.approx(camera.project((0, 0, 0)), abs=0.005)
    sides = 2 * np.array([cam.half_column, cam.half_row])
    assert pixels.std(0) == pytest.approx(sides / np.sqrt(12), rel=0.005)


def test_a_cube_s_shadow_is_a_voxel_wide_from_anywhere():
    for camera in four_cameras(64, 30.0):
        cam = pinhole_constants(camera, cubes(5, 5, 5))
        assert 2 * np.array([cam.half_column, cam.half_row]) == pytest.approx([1, 1], rel=1e-4)


@pytest.mark.parametrize(
    ("axis", "step", "moved"),
    [
        (2, (2, 0, 0), [1.879, 0]),  # cos 20 degrees along columns
        (1, (0, 2, 0), [0, -2]),
        (0, (0, 0, 2), [-0.684, 0]),  # the camera stands to the right: what comes nearer moves to the left
    ],
    ids=["x", "y", "z"],
)
def test_a_voxel_further_along_an_axis_appears_further(axis, step, moved):
    right = looking_at((0, 0, 0), Sensor(21, 21, 0.0055), scale_mm_px=SCALE_MM_PX, distance_mm=3e5, about_y_deg=20)
    other = looking_at((0, 0, 0), Sensor(21, 21, 0.0055), scale_mm_px=SCALE_MM_PX, distance_mm=3e5)
    projector, grid = PinholeProjector([right, other], cubes(7, 7, 7)), cubes(7, 7, 7)

    def centre(at):
        mask = np.zeros(grid.shape, bool)
        mask[at] = True
        image = projector.forward(0, SparseVolume.from_mask(grid, mask)).reshape(21, 21).astype(float)
        return np.array([image.sum(0) @ np.arange(21), image.sum(1) @ np.arange(21)])

    at = [2, 2, 2]
    start = centre(tuple(at))
    at[axis] += step[2 - axis]
    assert centre(tuple(at)) - start == pytest.approx(moved, abs=2e-3)


def test_the_same_on_any_number_of_threads():
    grid = cubes(20, 19, 9)
    projector, volume = PinholeProjector(four_cameras(32), grid), random_volume(grid)
    images = np.random.default_rng(2).normal(size=projector.seen.shape).astype(np.float32)
    threads, found = numba.get_num_threads(), []
    for number in (1, threads):
        numba.set_num_threads(number)
        lit = projector.candidates(np.abs(images), 0.5)
        found.append((projector.forward([0, 3], volume), projector.gather([0, 3], images[[0, 3]], volume), lit.values))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("views", "rounding"), [([1], 0.0), ([3, 0, 2], 2e-7)])
def test_voxels_are_multiplied(views, rounding):
    grid = cubes(9, 8, 4)
    projector, volume = PinholeProjector(four_cameras(20), grid), random_volume(grid)
    before, many = volume.values.copy(), len(views)
    corrections = np.random.default_rng(3).uniform(-3, 3, projector.seen.shape).astype(np.float32)
    total = projector.gather(views, corrections[views], volume)
    projector.multiply(views, corrections[views], volume)
    factor = [1 + s if s >= 0 else max(1 + s / many, 0) ** many for s in total]
    np.testing.assert_allclose(volume.values, before * factor, rtol=1e-6, atol=rounding)
    assert (volume.values == 0).any()


def test_lines_of_sight_against_a_loop():
    """A voxel stays where the light that its shadow meets exceeds the threshold in all cameras that must all see it."""
    cameras, grid = four_cameras(14), cubes(12, 13, 8)  # some voxels are beyond the sensors
    projector = PinholeProjector(cameras, grid)
    images = np.random.default_rng(4).exponential(5, projector.seen.shape).astype(np.float32)
    x, y, z = grid.axes()
    points = np.stack(np.meshgrid(z, y, x, indexing="ij"), -1)[..., ::-1].reshape(-1, 3)
    met = np.array([shadow_shares(c, grid).T @ i for c, i in zip(cameras, images, strict=True)])
    visible = np.all([c.sees(points) for c in cameras], 0)
    expected = visible & (met.min(0) > 2.5)
    assert 0 < visible.sum() < grid.size
    assert 0.1 < expected.sum() / visible.sum() < 0.9
    volume = projector.candidates(images, 2.5)
    np.testing.assert_array_equal(listed(volume), np.flatnonzero(expected))
    np.testing.assert_allclose(volume.values, met.prod(0)[expected] ** 0.25, rtol=1e-5)


def test_images_become_views_above_the_black_level():
    small = looking_at((0, 0, 0), Sensor(12, 10, 0.0055, 12, 7.0), scale_mm_px=SCALE_MM_PX, distance_mm=300)
    projector = PinholeProjector([four_cameras(20, black_level=60)[0], small], cubes(9, 8, 4))
    images = [np.full((20, 20), 61, np.uint16), np.arange(120, dtype=np.uint16).reshape(10, 12)]
    values = projector.values_of(images)
    assert projector.seen.sum(1).tolist() == [400, 120]
    assert (values[0] == 1).all()
    np.testing.assert_array_equal(values[1, :120], np.arange(120) - 7)
    assert (values[1, 120:] == 0).all()
    assert (projector.forward([0, 1], random_volume(projector.grid))[1, 120:] == 0).all()


def away(camera):
    """The same camera with its back to the volume."""
    return replace(camera, position_mm=tuple(-c for c in camera.position_mm))


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        (four_cameras(20)[:1], "1 given.*give two or more"),
        ([], "0 given"),
        ([four_cameras(20)[0], away(four_cameras(20)[1])], "camera 2: the volume reaches behind it"),
        (
            [four_cameras(20)[0], replace(four_cameras(20)[1], principal_point_px=(900.0, 10.0))],
            "camera 2: sees nothing",
        ),
    ],
)
def test_cameras_that_cannot_do(cameras, message):
    with pytest.raises(PlenoPIVError, match=message):
        PinholeProjector(cameras, cubes(9, 8, 4))


def test_images_that_are_not_the_cameras():
    projector = PinholeProjector(four_cameras(20), cubes(9, 8, 4))
    with pytest.raises(PlenoPIVError, match="3 for 4 cameras"):
        projector.values_of([np.zeros((20, 20))] * 3)
    with pytest.raises(PlenoPIVError, match="camera 3: its image has 19 x 20 px, its sensor 20 x 20"):
        projector.values_of([np.zeros((20, 20))] * 2 + [np.zeros((20, 19))] * 2)
    damaged = np.zeros((20, 20))
    damaged[7, 4] = np.nan
    with pytest.raises(PlenoPIVError, match=r"camera 4: the pixel at column 4, row 7 is nan, .* put a count there"):
        projector.values_of([np.zeros((20, 20))] * 3 + [damaged])
