"""The score of a velocity field: exact fields score nothing, known errors are found where they were put."""

import numpy as np
import pytest
from oracles.scorer import naive_score
from velocity_scenes import CAMERA, DT_S, HALF_MM, TO_VOXELS, VOXEL_MM, WINDOW
from velocity_scenes import field_and_particles as scene

from plenopiv.accuracy import score_velocity, true_displacements
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import flow

UNIFORM = flow("uniform", velocity_m_s=(0.21, -0.13, 0.17))
SHEAR = flow("shear", rate_per_s=60.0, component="y", along="z", drift_m_s=(0.02, 0.0, -0.1))


def score(dataset, a, b):
    return score_velocity(dataset, a, b, CAMERA, dt_s=DT_S, voxel_mm=VOXEL_MM, window_voxels=WINDOW)


@pytest.mark.parametrize("velocity", [UNIFORM, SHEAR], ids=["uniform", "shear"])
def test_an_exact_field_scores_zero(velocity):
    """Linear flows: window and point truth are both exact."""
    found = score(*scene(velocity))
    assert found.vectors > 100
    for errors in (found.final, found.raw, found.final_at_point, found.raw_at_point):
        assert (errors.answered, errors.gross) == (1.0, 0.0)
        assert max(errors.rms) < 1e-9
        assert len(errors.by_depth) == 3
    assert found.replaced == 0.0
    assert found.inside_1_std is None


def test_true_displacements_have_the_flow_s_size():
    found = score(*scene(UNIFORM))
    np.testing.assert_allclose(found.true_rms, np.abs([0.21, -0.13, 0.17]) * TO_VOXELS, rtol=1e-9)


def test_bias_keeps_axis_and_sign():
    found = score(*scene(SHEAR, error_voxels=(0.1, -0.2, 0.3)))
    np.testing.assert_allclose(found.final.bias, (0.1, -0.2, 0.3), atol=1e-9)
    np.testing.assert_allclose(found.final.rms, (0.1, 0.2, 0.3), atol=1e-9)
    for band in found.final.by_depth:
        np.testing.assert_allclose(band.bias, (0.1, -0.2, 0.3), atol=1e-9)


def judged(dataset, a, b):
    """Mask (z, y, x) of the vectors to be judged, by the rays through both rims of the main lens."""
    middle = 0.5 * (a + b)
    lo, hi = middle.min(0) + HALF_MM, middle.max(0) - HALF_MM
    z, y, x = np.meshgrid(dataset.z, dataset.y, dataset.x, indexing="ij")
    inside = np.ones(x.shape, bool)
    for values, first, last in zip((x, y, z), lo, hi, strict=True):
        inside &= (values >= first) & (values <= last)
    lens, sensor, e = CAMERA.main_lens, CAMERA.sensor, CAMERA.image_scale
    for values, half, pixels in ((x, HALF_MM[0], sensor.columns), (y, HALF_MM[1], sensor.rows)):
        for edge in (values - half, values + half):
            for u in (-0.5 * lens.aperture_mm, 0.5 * lens.aperture_mm):
                s = CAMERA.spread(z) * u + CAMERA.scale(z) * edge
                inside &= np.abs(s) * (1 + e) <= 0.5 * pixels * sensor.pixel_pitch_mm
    return inside


def test_vectors_are_judged_where_windows_are_seeded_and_seen():
    dataset, a, b = scene(UNIFORM, box=(3.0, 3.0, 2.0), n=20_000)  # now the views end before the seeding
    wide = dataset.assign_coords(x=dataset.x * 1.5, y=dataset.y * 1.5)
    mask = judged(wide, a, b)
    assert 0 < mask.sum() < mask.size
    assert mask[mask.shape[0] // 2].sum() > mask[0].sum()  # a narrower field away from focus
    assert score(wide, a, b).vectors == mask.sum()
    for name in "uvw":
        wide[name].values[0][~mask] = 1e6  # not judged, so no harm
    assert max(score(wide, a, b).final.rms) < 1e-9


def test_gross_errors_are_counted_and_left_out():
    dataset, a, b = scene(UNIFORM)
    places = np.argwhere(judged(dataset, a, b))[[3, 20, 41]]
    for axis, (name, sign) in enumerate((("u", 1), ("v", -1), ("w", 1))):  # one gross component spoils a vector
        dataset[name].values[0][tuple(places[axis])] += sign * 2.1 / TO_VOXELS[axis]
    found = score(dataset, a, b)
    assert found.final.gross == pytest.approx(3 / found.vectors)
    assert max(found.final.rms) < 1e-9
    assert found.raw.gross == 0.0


def test_an_error_below_two_voxels_is_not_gross():
    found = score(*scene(UNIFORM, error_voxels=(1.9, 0.0, 0.0)))
    assert found.final.gross == 0.0
    assert found.final.rms[0] == pytest.approx(1.9)


def test_raw_and_final_are_told_apart():
    dataset, a, b = scene(UNIFORM)
    dataset["w_raw"].values += 0.4 / TO_VOXELS[2]
    found = score(dataset, a, b)
    np.testing.assert_allclose(found.raw.rms, (0, 0, 0.4), atol=1e-9)
    assert max(found.final.rms) < 1e-9


def test_unanswered_and_replaced_vectors():
    dataset, a, b = scene(UNIFORM)
    mask = judged(dataset, a, b)
    first, second = (tuple(p) for p in np.argwhere(mask)[[0, 5]])
    dataset["v"].values[0][first] = np.nan
    dataset["valid"].values[0][second] = 0
    found = score(dataset, a, b)
    assert found.final.answered == pytest.approx(1 - 1 / mask.sum())
    assert found.replaced == pytest.approx(1 / mask.sum())
    assert found.final.gross == 0.0


def test_errors_by_depth_are_where_they_are():
    dataset, a, b = scene(UNIFORM)
    dataset["u"].values += (0.1 * np.abs(dataset.z.values) / TO_VOXELS[0])[None, :, None, None]
    bands = score(dataset, a, b).final.by_depth
    for band in bands:
        assert 0.1 * band.from_mm - 1e-9 <= band.rms[0] <= 0.1 * band.to_mm + 1e-9
    assert bands[0].rms[0] < bands[2].rms[0]


def test_stated_uncertainty():
    """Normal errors of known spread: 68 and 95 % lie inside; half the spread stated leaves 38 and 68 %."""
    dataset, a, b = scene(UNIFORM, n=4000)
    dataset = dataset.interp(x=np.linspace(-1.2, 1.2, 25), y=np.linspace(-0.8, 0.8, 25))
    rng = np.random.default_rng(5)
    for name, scale, share in zip("uvw", TO_VOXELS, (1.0, 1.0, 0.5), strict=True):
        dataset[name] = dataset[name] + 0.2 / scale * rng.standard_normal(dataset[name].shape)
        dataset[f"{name}_std"] = (dataset[name].dims, np.full(dataset[name].shape, share * 0.2 / scale))
    found = score(dataset, a, b)
    np.testing.assert_allclose(found.inside_1_std, (0.683, 0.683, 0.383), atol=0.04)
    np.testing.assert_allclose(found.inside_2_std, (0.954, 0.954, 0.683), atol=0.04)


def test_window_truth_averages_what_point_truth_does_not():
    """At the crest of cos(k z) a window of half height h sees its mean, sin(kh)/(kh); the point truth is nearly 1."""
    wavelength = 4.0
    k = 2 * np.pi / wavelength
    rng = np.random.default_rng(1)
    half = np.array([0.4, 0.4, 0.6])
    middle = rng.uniform(-1.2, 1.2, (40_000, 3))
    disp = np.stack([np.cos(k * middle[:, 2]), np.zeros(len(middle)), np.zeros(len(middle))], -1)
    found = true_displacements(np.zeros((1, 3)), middle - disp / 2, middle + disp / 2, half)
    assert found.window[0, 0] == pytest.approx(np.sin(k * 0.6) / (k * 0.6), abs=0.01)
    assert found.point[0, 0] == pytest.approx(1.0, abs=0.02)
    assert found.particles[0] == pytest.approx(40_000 * np.prod(half) / 1.2**3, rel=0.05)


def test_too_few_particles_are_no_truth():
    five = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    found = true_displacements(np.zeros((1, 3)), five, five, np.full(3, 2.0))
    assert found.particles[0] == 5
    assert np.isnan(found.window).all()


def test_what_cannot_be_judged_is_said():
    dataset, a, b = scene(UNIFORM)
    with pytest.raises(PlenoPIVError, match="whole window"):
        score(dataset.assign_coords(z=dataset.z + 10), a, b)
    with pytest.raises(PlenoPIVError, match="dims"):
        score(dataset.transpose("time", "x", "y", "z"), a, b)


def test_agrees_with_the_independent_scorer():
    """A vortex ring with noise, a gross error and a replaced vector, judged by both."""
    ring = flow("vortex-ring", radius_mm=1.0, core_radius_mm=0.5, circulation_mm2_s=400.0, drift_m_s=(0.0, 0.1, 0.05))
    dataset, a, b = scene(ring, error_voxels=(0.05, 0.0, -0.1))
    rng = np.random.default_rng(2)
    for name, scale in zip("uvw", TO_VOXELS, strict=True):
        for each in (name, f"{name}_raw"):
            dataset[each].values += 0.3 * rng.standard_normal(dataset[each].shape) / scale
        dataset[f"{name}_std"] = (dataset[name].dims, np.full(dataset[name].shape, 0.25 / scale))
    middle = tuple(n // 2 for n in dataset["u"].shape[1:])
    dataset["u"].values[0][middle] += 5 / TO_VOXELS[0]
    dataset["valid"].values[0][middle] = 0
    theirs = naive_score(dataset, a, b, CAMERA, dt_s=DT_S, voxel_mm=VOXEL_MM, window_voxels=WINDOW)
    ours = score(dataset, a, b)
    assert ours.vectors == theirs["vectors"] > 100
    assert ours.vectors_at_half_overlap == theirs["vectors_at_half_overlap"]
    assert ours.particles_per_window == pytest.approx(theirs["particles_per_window"])
    for errors, name in ((ours.final, "final"), (ours.raw, "raw"), (ours.final_at_point, "final_at_point")):
        assert errors.gross == pytest.approx(theirs[name]["gross"])
        np.testing.assert_allclose(errors.rms, theirs[name]["rms"], rtol=1e-9)
        np.testing.assert_allclose(errors.bias, theirs[name]["bias"], atol=1e-9)
        np.testing.assert_allclose([band.rms for band in errors.by_depth], theirs[name]["by_depth"], rtol=1e-9)
    assert ours.final.gross > 0
    assert ours.replaced == pytest.approx(theirs["replaced"])
    np.testing.assert_allclose([ours.inside_1_std, ours.inside_2_std], theirs["inside"])


def test_a_field_of_the_laboratory_is_scored_as_its_image_in_lens_space():
    """Shifted, and deeper by the index of water: the same vectors are judged, with the same errors in voxels."""
    n, shift = 1.333, np.array([5.0, -3.0, 40.0])
    dataset, a, b = scene(SHEAR, box=(3.0, 3.0, 2.0), n=20_000, error_voxels=(0.1, -0.2, 0.3))
    points = np.random.default_rng(0).uniform(-6, 6, (100, 3))
    space = SpaceMap.fitted(points * (1, 1, n) + shift, points, 1)
    there = dataset.assign_coords(x=dataset.x + 5, y=dataset.y - 3, z=n * dataset.z + 40)
    for name in ("w", "w_raw"):
        there[name] = n * there[name]
    here = score(dataset, a, b)
    voxel = (*VOXEL_MM[:2], n * VOXEL_MM[2])
    options = {"dt_s": DT_S, "voxel_mm": voxel, "window_voxels": WINDOW}
    a, b = (p * (1, 1, n) + shift for p in (a, b))
    found = score_velocity(there, a, b, CAMERA, space=space, **options)
    assert found.vectors == here.vectors
    np.testing.assert_allclose(found.final.bias, (0.1, -0.2, 0.3), atol=1e-9)
    for one, other in zip(found.final.by_depth, here.final.by_depth, strict=True):
        assert (one.from_mm, one.to_mm) == pytest.approx((other.from_mm, other.to_mm))
        assert one.rms == pytest.approx(other.rms)
    with pytest.raises(PlenoPIVError, match="no vector has a whole window"):
        score_velocity(there, a, b, CAMERA, **options)  # as the camera's they would lie far before its field of view
