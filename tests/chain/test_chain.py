"""The chain as plain data: the same bits on the other side of pickle, for every kind of camera."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.tomography import cubes, four_cameras

from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (0.5, 1.7), (0.025, 0.025, 0.1))
SHORT = ReconstructionSettings(iterations=2)
WINDOWS = CorrelationSettings(windows=((32, 32, 12),), inner_window=(16, 16, 8), fine_passes=1)
MOVED_MM = np.array([0.05, 0.025, 0.1])
LIGHT = 20_000.0


def places(grid, count, seed=0):
    half = [0.5 * (hi - lo) for lo, hi in grid.limits_mm()]
    middle = [0.5 * (hi + lo) for lo, hi in grid.limits_mm()]
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * half + middle


def plenoptic_chain():
    return Chain((small_camera("hexagonal", pmr=8, microlenses=(30, 26)),), GRID, SHORT, WINDOWS, 0.5)


def plenoptic_frames(chain):
    camera = chain.camera
    at = places(GRID, 60) - MOVED_MM / 2
    black = camera.sensor.black_level
    return [[particle_image(camera, Particles(p, np.full(60, LIGHT))) + black] for p in (at, at + MOVED_MM)]


def tomographic_chain():
    return Chain(tuple(four_cameras(40)), cubes(24, 23, 22), TOMOGRAPHY)


def tomographic_frames(chain):
    at = places(chain.grid, 10)
    return [[pinhole_image(camera, Particles(at, np.full(10, 500.0))) for camera in chain.cameras]]


def two_camera_chain():
    grid = VoxelGrid.covering((-0.5, 0.6), (-0.3, 0.3), (-0.6, 0.5), (0.04, 0.03, 0.05))
    camera = small_camera("hexagonal", pmr=8, microlenses=(40, 40))
    return Chain((camera, camera), grid, SHORT, poses=(FRONT, SIDE))


def two_camera_frames(chain):
    at = np.array([[0.3, 0.1, -0.4]])
    sides = zip(chain.cameras, chain.poses, strict=True)
    return [
        [
            particle_image(camera, Particles(pose.in_camera(at), np.full(1, LIGHT))) + camera.sensor.black_level
            for camera, pose in sides
        ]
    ]


KINDS = {
    "one plenoptic camera": (plenoptic_chain, plenoptic_frames),
    "two plenoptic cameras": (two_camera_chain, two_camera_frames),
    "pinhole cameras": (tomographic_chain, tomographic_frames),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_bits_after_pickle(kind):
    make, frames_of = KINDS[kind]
    chain = make()
    frames = frames_of(chain)
    before = [chain.reconstruct(images).volume for images in frames]  # the projection is made now
    sent = pickle.dumps(chain)
    assert len(sent) < 20_000  # plain data, no projection
    other = pickle.loads(sent)
    assert other == chain
    after = [other.reconstruct(images).volume for images in frames]
    for a, b in zip(before, after, strict=True):
        assert a.column.size > 0
        np.testing.assert_array_equal(a.row_start, b.row_start)
        np.testing.assert_array_equal(a.column, b.column)
        np.testing.assert_array_equal(a.values, b.values)
    if len(frames) == 2:
        fields = [c.velocity(*volumes, dt_s=1e-3) for c, volumes in ((chain, before), (other, after))]
        for name in fields[0].data_vars:
            np.testing.assert_array_equal(fields[0][name], fields[1][name])
        for name in ("near_focus", "near_face"):
            assert (name in fields[0]) == (kind == "one plenoptic camera")


def test_velocity_has_the_signs_and_units_of_the_motion():
    chain = plenoptic_chain()
    a, b = (chain.reconstruct(images).volume for images in plenoptic_frames(chain))
    field = chain.velocity(a, b, dt_s=1e-3, time_s=0.25).isel(time=0)
    assert float(field.time) == 0.25
    for name, moved_mm, voxel_mm in zip("uvw", MOVED_MM, GRID.voxel_mm, strict=True):
        assert float(field[name].median()) == pytest.approx(moved_mm, abs=0.3 * voxel_mm)  # mm in 1 ms are m/s
    ends = np.array(chain.camera.dead_zone_mm())
    deep = chain.correlation.windows[-1][2] * GRID.voxel_mm[2]
    for z, near in zip(field.z, field.near_focus, strict=True):
        reaches = any(1.5 * ends[0] < z + part * deep < 1.5 * ends[1] for part in np.linspace(-0.25, 0.25, 201))
        assert (near == reaches).all()
    low, high = GRID.limits_mm()[2]
    for z, at_face in zip(field.z, field.near_face, strict=True):
        assert (at_face == (min(z - low, high - z) < 0.75 * deep)).all()
    moved = chain.displacement(a, b)
    np.testing.assert_allclose(field.u, moved.displacement[0] * GRID.voxel_mm[0], rtol=1e-12)


def test_volumes_of_another_grid_are_refused():
    """Their vectors would lie elsewhere than their light."""
    chain = plenoptic_chain()
    a, b = (chain.reconstruct(images).volume for images in plenoptic_frames(chain))
    other = replace(chain, grid=VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (0.0, 1.2), GRID.voxel_mm))
    with pytest.raises(PlenoPIVError, match=r"volume: <VoxelGrid.*, but the chain's is <VoxelGrid"):
        other.velocity(a, b, dt_s=1e-3)


def test_vectors_at_front_and_back_are_told_along_z():
    deep = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (0.5, 2.9), (0.025, 0.025, 0.1))
    windows = CorrelationSettings(windows=((32, 32, 8),), inner_window=(16, 16, 8))
    chain = replace(plenoptic_chain(), grid=deep, correlation=windows)
    z, none = np.arange(3.5, 24.0, 8.0), np.zeros((3, 3, 1, 2))
    of_windows = np.ones(none.shape[1:])
    field = DisplacementField(
        z, np.array([15.5]), np.array([15.5, 23.5]), none, none, of_windows > 0, of_windows.astype(np.float32), none
    )
    near = chain.dataset(field, 1e-3).near_face.values[0]
    assert near.shape == (3, 1, 2)
    assert near.all((1, 2)).tolist() == [True, False, True]


def test_an_ensemble_of_one_pair_is_that_pair_with_the_same_weights():
    """Light near focus and voxels behind a mask count less in both."""
    sensor = plenoptic_chain().camera.sensor
    masked = np.zeros((sensor.rows, sensor.columns), bool)
    masked[: sensor.rows // 3] = True
    chain = replace(plenoptic_chain(), unusable=(masked,), reconstruction=replace(SHORT, focus_reach=8.0))
    volumes = tuple(chain.reconstruct(images).volume for images in plenoptic_frames(chain))
    assert chain.depth_weights.values.min() < 0.9
    assert np.ptp(chain.weighted(volumes[0]).values / volumes[0].values) > 0.2
    one, many = chain.velocity(*volumes, 1e-3, 0.25), chain.ensemble([volumes], 1e-3, 0.25)
    assert many.identical(one)
    plain = measure(*volumes, chain.correlation)
    assert not np.array_equal(plain.displacement[0] * GRID.voxel_mm[0], many.u[0])
    twice = chain.ensemble([volumes, volumes], 1e-3)
    np.testing.assert_allclose(twice.u[0], one.u[0], atol=1e-3)


def test_light_near_focus_counts_less_for_one_plenoptic_camera_alone():
    across_focus = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (-2, 2), (0.025, 0.025, 0.1))
    chain = replace(plenoptic_chain(), grid=across_focus)
    weights = chain.depth_weights.values[:, 0, 0]
    z = np.abs(across_focus.axes()[2])
    assert weights.shape == z.shape
    assert weights[np.argmin(z)] < 0.1 < weights[np.argmax(z)] == 1.0
    flat = replace(chain, reconstruction=replace(SHORT, focus_reach=0.0))
    assert flat.depth_weights is None
    assert two_camera_chain().depth_weights is None
    assert tomographic_chain().depth_weights is None


def test_cameras_that_do_not_go_together():
    plenoptic, pinholes = plenoptic_chain(), tomographic_chain()
    for cameras, poses in (
        (plenoptic.cameras + pinholes.cameras, (FRONT,)),
        (plenoptic.cameras * 2, (FRONT,)),
        (plenoptic.cameras, (FRONT, SIDE)),
    ):
        with pytest.raises(PlenoPIVError, match="give plenoptic cameras with a pose each, or pinhole cameras alone"):
            _ = replace(plenoptic, cameras=cameras, poses=poses).projection
    with pytest.raises(PlenoPIVError, match="this takes one plenoptic camera"):
        _ = pinholes.camera
    with pytest.raises(PlenoPIVError, match="unusable: pinhole cameras have no masks"):
        _ = replace(pinholes, unusable=(np.ones((4, 4), bool), *(None for _ in pinholes.cameras[1:]))).projection


def test_methods_of_other_cameras():
    plenoptic, pinholes = plenoptic_chain(), tomographic_chain()
    (image,) = plenoptic_frames(plenoptic)[0]
    with pytest.raises(PlenoPIVError, match='"mlos-mart" is for pinhole cameras; use "drt-mart"'):
        replace(plenoptic, reconstruction=TOMOGRAPHY).reconstruct([image])
    with pytest.raises(PlenoPIVError, match='"drt-mart" is for plenoptic cameras; use "mlos-mart"'):
        replace(pinholes, reconstruction=SHORT).reconstruct(tomographic_frames(pinholes)[0])


def test_images_that_are_not_the_cameras():
    chain = plenoptic_chain()
    (image,) = plenoptic_frames(chain)[0]
    with pytest.raises(PlenoPIVError, match=r"images of 7 x 5 px; give one of \d+ x \d+ px"):
        chain.reconstruct([np.zeros((5, 7))])
    with pytest.raises(PlenoPIVError, match="as the camera's sensor"):
        chain.reconstruct([image, image])


def test_masks_that_are_not_the_cameras():
    chain = plenoptic_chain()
    sensor = chain.camera.sensor
    mask = np.zeros((sensor.rows, sensor.columns), bool)
    with pytest.raises(PlenoPIVError, match=r"0 pinhole, 1 poses, 2 masks; .* masks of all or none"):
        _ = replace(chain, unusable=(mask, mask)).projection
    with pytest.raises(PlenoPIVError, match=r"unusable: \d+ x 100 px; give"):
        _ = replace(chain, unusable=(mask[:100],)).projection


def test_a_volume_beyond_the_front_focal_plane():
    """Rays from there leave the main lens parallel, or apart."""
    near = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (49.0, 51.0), (0.05, 0.05, 0.1))
    with pytest.raises(PlenoPIVError, match="beyond the main lens' front focal plane at 50 mm"):
        _ = replace(plenoptic_chain(), grid=near).projection


@pytest.mark.parametrize("z_mm", [(99.0, 102.0), (150.0, 151.0)])
def test_a_volume_that_reaches_to_the_main_lens(z_mm):
    """Whether one camera looks at it, or one of two that is turned against it."""
    behind = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), z_mm, (0.05, 0.05, 0.1))
    with pytest.raises(PlenoPIVError, match=r"not in front of the main lens at 100 mm; .* are all lengths in mm"):
        _ = replace(plenoptic_chain(), grid=behind).projection
    with pytest.raises(PlenoPIVError, match="not in front of the main lens at 100 mm"):
        _ = replace(two_camera_chain(), grid=behind).projection


@pytest.mark.parametrize(
    ("make", "cameras"),
    [
        (plenoptic_chain, "one plenoptic camera"),
        (two_camera_chain, "2 plenoptic cameras"),
        (tomographic_chain, "4 pinhole cameras"),
    ],
)
def test_the_title_says_of_which_cameras(make, cameras):
    at, none = np.array([7.5]), np.zeros((3, 1, 1, 1))
    field = DisplacementField(at, at, at, none, none, none[0] == 0, none[0].astype(np.float32), none)
    assert make().dataset(field, 1e-3).attrs["title"] == f"Volumetric velocity from {cameras}"


@pytest.mark.parametrize(
    ("chain", "frames"), [(plenoptic_chain, plenoptic_frames), (tomographic_chain, tomographic_frames)]
)
def test_static_light_is_of_each_camera(chain, frames):
    whole = chain()
    images = frames(whole)[0]
    for static in ([], [np.zeros_like(image) for image in [*images, images[0]]]):
        with pytest.raises(PlenoPIVError, match="images"):
            whole.reconstruct(images, static=static)
