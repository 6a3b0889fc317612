"""One particle, from its traced image to its voxel: signs of all axes, both orientations, both methods."""

import numba
import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import dark_to_light, most_light
from plenopiv.reconstruction.noise import Noise
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.sensor import upright
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

ELECTRONS = 60000.0
CAMERAS = {
    kind: small_camera(kind, pmr=8, microlenses=(21, 19), offset_mm=(0.004, -0.007)) for kind in ("square", "hexagonal")
}
LAYOUTS = {kind: layout(camera) for kind, camera in CAMERAS.items()}
VOXEL = 0.022  # half a microlens in the object
GRID = VoxelGrid.covering((-0.33, 0.33), (-0.33, 0.33), (-1.8, 1.8), (VOXEL, VOXEL, 0.1))
X, Y, Z = 0.121, 0.165, 1.05
PLACES = [(X, 0.011, Z), (-X, 0.011, Z), (0.011, Y, -Z), (0.011, -Y, -Z), (X, -Y, Z), (-X, Y, -Z)]


def image_of(kind, place, electrons=ELECTRONS):
    return particle_image(CAMERAS[kind], Particles(np.array([place], float), np.array([electrons])), rays=200_000)


def reconstructed(kind, image, across=None, **settings):
    where = LAYOUTS[kind]
    settings = ReconstructionSettings(**{"method": "drt-mart", "iterations": 5, "relaxation": 0.3, **settings})
    projector = PlenopticProjector(where, GRID, settings.weights, **({} if across is None else {"across": across}))
    return reconstruct(projector.values_of([image]), projector, settings)


def centre_of_light(volume):
    values = volume.dense().values.astype(float)
    x, y, z = GRID.axes()
    total = values.sum()
    return np.array([(values.sum((0, 1)) @ x), (values.sum((0, 2)) @ y), (values.sum((1, 2)) @ z)]) / total, total


@pytest.mark.parametrize(("across", "limit"), [pytest.param(None, 0.06, id="7.0-0.06"), (14.0, 0.03)])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_a_particle_is_found_at_its_place(kind, place, across, limit):
    """With all of its light, to what interpolation on the maps leaves."""
    found = reconstructed(kind, image_of(kind, place), across)
    centre, total = centre_of_light(found.volume)
    off = (centre - place) / GRID.voxel_mm
    print(
        f"\n{kind} {place}: off by {off.round(3)} voxels, light {total / ELECTRONS:.4f}, "
        f"DRT left {found.candidates:.4f}"
    )
    assert np.abs(off).max() < 1.0
    assert total == pytest.approx(ELECTRONS, rel=limit)
    peak = np.unravel_index(found.volume.dense().values.argmax(), GRID.shape)
    at = [axis[k] for axis, k in zip(GRID.axes(), peak[::-1], strict=True)]
    assert (np.abs(np.array(at) - place) <= 1.01 * np.array(GRID.voxel_mm)).all()


def test_orientation_of_the_stored_image():
    """The same scene stored as it falls on the chip: turned upright it gives the same volume; taken as it is, not."""
    place = (X, -Y, Z)
    stored = upright(image_of("square", place), "sensor")
    right = reconstructed("square", upright(stored, "sensor"))
    np.testing.assert_array_less(np.abs(centre_of_light(right.volume)[0] - place) / GRID.voxel_mm, 1.0)
    wrong, _ = centre_of_light(reconstructed("square", stored, method="mart").volume)
    np.testing.assert_allclose(wrong[:2], (-X, Y), atol=0.044)  # a camera that is turned by 180 degrees


def test_mart_and_drt_mart_agree():
    place = (X, -Y, Z)
    image = image_of("hexagonal", place)
    full, quick = (reconstructed("hexagonal", image, method=m).volume for m in ("mart", "drt-mart"))
    (a, light_a), (b, light_b) = centre_of_light(full), centre_of_light(quick)
    print(f"\nmart - drt-mart: {((a - b) / GRID.voxel_mm).round(4)} voxels, light {light_a / light_b:.4f}")
    assert (np.abs(a - b) < 0.1 * np.array(GRID.voxel_mm)).all()
    assert light_a == pytest.approx(light_b, rel=0.02)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("place", [PLACES[0], PLACES[3]], ids=str)
def test_the_papers_product_keeps_the_true_voxel(kind, place):
    """Noise-free, one ray a view, no tolerance: a product of all pixels. The true voxel stays and few others do."""
    where = LAYOUTS[kind]
    projector = PlenopticProjector(where, GRID, "1-ray")
    lightfield = decode(image_of(kind, place), where)
    alive = projector.candidates(dark_to_light(lightfield, 0.0), 1.0).dense().values > 0
    k, j, i = (int(np.argmin(np.abs(axis - p))) for axis, p in zip(GRID.axes()[::-1], place[::-1], strict=True))
    assert alive[k, j, i]
    assert alive.mean() < 2e-3
    # what stays is around the particle: DRT cannot tell depths closer than its rays do
    z, y, x = np.nonzero(alive)
    assert max(np.abs(x - i).max(), np.abs(y - j).max()) <= 2
    assert np.abs(z - k).max() <= 6


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_the_bound_keeps_a_noisy_particle(kind, place):
    """One of the voxels next to the particle stays, and few others do, although every pixel is noisy."""
    where = LAYOUTS[kind]
    grid = VoxelGrid.covering((-0.25, 0.25), (-0.25, 0.25), (-1.5, 1.5), (VOXEL / 2, VOXEL / 2, 0.05))
    projector = PlenopticProjector(where, grid, "exact")
    image = image_of(kind, place, 60_000.0)
    noisy = np.random.default_rng(0).normal(image, 2 + np.sqrt(image))
    lightfield, noise = decode(noisy, where), Noise(2.0, 1.0)
    first = np.floor((np.array(place) - grid.first_mm) / grid.voxel_mm).astype(int)
    around = tuple(slice(n, n + 2) for n in first[::-1])
    kept = projector.candidates(most_light(lightfield, noise), 0.5 * 60_000.0).dense().values > 0
    assert kept[around].any()
    assert kept.mean() < 0.05


def test_results_do_not_depend_on_threads():
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    image, found = image_of("square", PLACES[4]), []
    noisy = np.rint(image + np.random.default_rng(0).normal(0, 2, image.shape))
    for threads in (1, 2):
        numba.set_num_threads(threads)
        found.append([reconstructed("square", noisy, method=m, iterations=2) for m in ("drt-mart", "mart")])
    for one, two in zip(*found, strict=True):
        assert one.residuals == two.residuals
        np.testing.assert_array_equal(one.volume.row_start, two.volume.row_start)
        np.testing.assert_array_equal(one.volume.column, two.volume.column)
        np.testing.assert_array_equal(one.volume.values, two.volume.values)
