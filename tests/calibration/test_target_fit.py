"""The optics from dots: what a fit finds, what it leaves out, and what is refused."""

import warnings
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibrations import calibrated

import plenopiv.calibration.target.calibrated as module
from plenopiv.calibration.lattice_fit import LatticeFit
from plenopiv.calibration.target.board import Board, TargetImage
from plenopiv.calibration.target.calibrated import (
    PlaneResidual,
    _check_agreement,
    _compare_with_sheet,
    _plane,
    _warn_of_three_planes,
    lens_space_camera,
)
from plenopiv.calibration.target.fit import Dots, _check_order, _check_planes
from plenopiv.calibration.target.optics_fit import fit_optics
from plenopiv.cameras.lens_space import images_of
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import LensRim, MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel, on_disc
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

SHEET = PlenopticCamera(
    MainLens(50.5, 22.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(480, 400, 0.0055, 12, 60)
)
WATER = Medium(1.333, 40.0, 8.0, 1.52)
CORNER_MM = 0.5 * 0.0055 * float(np.hypot(480, 400))
TRUTH = {
    "focal_length_mm": 50.0, "image_distance_mm": 100.1, "gap_mm": 63.5, "fluid_mm": 40.6, "refractive_index": 1.3335,
    "microlens_focal_length_mm": 0.307, "reference_mm": 104.0, "turn_x_rad": 0.004, "turn_y_rad": -0.003,
    "turn_z_rad": 0.02, "x_mm": 0.06, "y_mm": -0.04, "distortion": 0.008, "gap_tilt_s": 0.004, "gap_tilt_t": -0.006,
    "plane_turn_x_rad": 0.011, "plane_turn_y_rad": -0.007,
}  # fmt: skip
STD_MM = np.array([1e-4, 1e-4, 2e-3])
BOARD = Board(0.5, 0.16, 0.28, 0.22)


def names(prefix):
    return tuple(TRUTH[f"{prefix}_{axis}_rad"] for axis in "xyz")


def dots_of(camera, planes=(-3.0, -1.5, 0.0, 1.5, 3.0), seed=1, board=BOARD):
    """Dots where the rays of TRUTH have their images, and noise."""
    t = TRUTH
    water = replace(WATER, fluid_mm=t["fluid_mm"], refractive_index=t["refractive_index"])
    scale = t["microlens_focal_length_mm"] / t["reference_mm"] / camera.image_scale
    model = RayModel(
        t["focal_length_mm"], t["image_distance_mm"], t["gap_mm"], water, t["reference_mm"], CORNER_MM, names("turn"),
        (t["x_mm"], t["y_mm"]), t["distortion"], (t["gap_tilt_s"], t["gap_tilt_t"]), scale,
    )  # fmt: skip
    number = np.array([(i, j) for i in range(-2, 3) for j in range(-1, 2)])
    places = np.concatenate([board.places_mm(number, z) for z in planes])
    n, aperture = len(places), 18.0
    about_x, about_y, reading = t["plane_turn_x_rad"], t["plane_turn_y_rad"], np.repeat(planes, len(number))
    x, y, relief = (places - reading[:, None] * [0, 0, 1]).T  # of the target, turned to first order: .1 um
    off_square = np.column_stack(
        [x + relief * about_y, y - relief * about_x, reading + relief + y * about_x - x * about_y]
    )
    images = images_of(off_square, model, camera, 61, aperture).place_mm
    return Dots(
        np.repeat(np.arange(len(planes)), len(number)),
        np.tile(number, (len(planes), 1)),
        places,
        reading,
        images + np.random.default_rng(seed).normal(0, 1, (n, 3)) * STD_MM,
        np.tile(STD_MM, (n, 1)),
        np.ones(n),
        np.ones(n, bool),
        aperture,
        np.zeros((len(planes), 1, 2)),
    )


def lens_space():
    """The camera of lens space as the white image of TRUTH would give it."""
    growth = TRUTH["microlens_focal_length_mm"] / TRUTH["reference_mm"]
    distance = SHEET.microlens_focal_length_mm / growth
    return replace(SHEET, main_lens=MainLens(distance / 2, 22.0, -1.0))


@pytest.mark.parametrize("pupil_mm", [66.0, 150.0])
@pytest.mark.parametrize("medium", [None, WATER])
def test_the_stated_focal_length_is_that_of_the_lens_wherever_the_exit_pupil_is(monkeypatch, pupil_mm, medium):
    """The camera of lens space stands in the exit pupil: its focal length is another one."""
    monkeypatch.setitem(TRUTH, "reference_mm", pupil_mm)
    camera = lens_space()
    assert abs(camera.main_lens.focal_length_mm - SHEET.main_lens.focal_length_mm) > 15
    found = fit_optics(dots_of(camera), camera, medium, SHEET.main_lens.focal_length_mm)
    for name in ("focal_length_mm", "image_distance_mm", "fluid_mm", "refractive_index", "microlens_focal_length_mm"):
        assert abs(found.values[name] - TRUTH[name]) < 2.5 * found.std[name], name
    assert max(found.off_sheet.values()) < 2


@pytest.fixture(scope="module")
def fitted():
    """Dots with two outliers, one of which is not whole, and their fit."""
    camera = lens_space()
    dots = dots_of(camera)
    dots.lens_mm[7] += 0.02, 0.0, 0.0
    dots.lens_mm[40] += 0.0, 0.02, 0.0
    dots.whole[40] = False
    return dots, fit_optics(dots, camera, WATER)


@pytest.mark.full
def test_parameters_are_found_within_three_standard_deviations(fitted):
    _, found = fitted
    for name, exact in TRUTH.items():
        assert abs(found.values[name] - exact) < 3 * found.std[name], name
    exact = 1 - TRUTH["image_distance_mm"] / TRUTH["focal_length_mm"]
    assert abs(found.values["magnification"] - exact) < 3 * found.std["magnification"]
    assert found.std["magnification"] < 1e-3
    assert found.std["turn_z_rad"] < 1e-3
    assert found.std["distortion"] < 2e-3


def test_outliers_and_cut_dots_are_left_out(fitted):
    _, found = fitted
    assert np.flatnonzero(~found.used).tolist() == [7, 40]
    assert found.residual_mm[7, 0] == pytest.approx(0.02, abs=2e-3)
    assert found.residual_mm[40, 1] == pytest.approx(0.02, abs=2e-3)


def test_outliers_are_told_of_and_count_in_no_residual(fitted):
    dots, found = fitted
    planes = [_plane(TargetImage(f"{n}.tif", 1.5 * n, np.zeros(1)), n, dots, found) for n in range(5)]
    assert [(plane.dots, plane.whole, plane.outliers) for plane in planes] == [
        (15, 15, 1), (15, 15, 0), (15, 14, 0), (15, 15, 0), (15, 15, 0),
    ]  # fmt: skip
    assert max(plane.rms_um[0] for plane in planes) < 0.4  # 5 with the outlier
    elsewhere = replace(found, used=found.used & (dots.plane != 3))
    assert _plane(TargetImage("3.tif", 4.5, np.zeros(1)), 3, dots, elsewhere).outliers == 0


def test_residuals_are_the_noise_and_left_out_ones_more(fitted):
    _, found = fitted
    rms, left_out = (np.sqrt((r[found.used] ** 2).mean(0)) for r in (found.residual_mm, found.left_out_mm))
    in_fluid = STD_MM * (1, 1, TRUTH["refractive_index"])  # depths in air look shorter
    assert (rms < 1.1 * in_fluid).all()
    assert (rms > 0.7 * in_fluid).all()
    assert (left_out > rms).all()


@pytest.mark.parametrize("reading_mm", [120.0, -120.0])
def test_a_traverse_may_have_its_zero_anywhere(fitted, reading_mm):
    """The same optics, and the same rays of the same dots, whatever the traverse reads in focus."""
    dots, at_focus = fitted
    far = dots.laboratory_mm + np.array([0.0, 0.0, reading_mm])
    far = replace(dots, laboratory_mm=far, reading_mm=dots.reading_mm + reading_mm)
    found = fit_optics(far, lens_space(), WATER)
    np.testing.assert_allclose(found.residual_mm, at_focus.residual_mm, atol=1e-5)
    np.testing.assert_allclose(found.left_out_mm, at_focus.left_out_mm, atol=1e-5)
    aperture = on_disc(9.0, 5)
    for here, there in zip(
        found.model.trace(far.laboratory_mm, aperture), at_focus.model.trace(dots.laboratory_mm, aperture), strict=True
    ):
        np.testing.assert_allclose(here, there, atol=2e-5)
    moved = {"x_mm", "y_mm", "fluid_mm"}
    for name, value in at_focus.values.items():
        if name not in moved:
            assert found.values[name] == pytest.approx(value, abs=0.01 * at_focus.std[name]), name
            assert found.std[name] == pytest.approx(at_focus.std[name], rel=1e-3), name
    assert found.values["fluid_mm"] == pytest.approx(at_focus.values["fluid_mm"] + reading_mm, abs=2e-3)
    tilt = found.std["turn_y_rad"] * abs(reading_mm)  # turned about the zero, which is far
    assert found.std["x_mm"] == pytest.approx(tilt, rel=0.2)


@pytest.mark.full
def test_both_levels_of_a_target_turn_with_it():
    """What is left is noise, as of a flat target, and the step tells how square the target is ten times as well."""
    camera = lens_space()
    found = fit_optics(dots_of(camera, board=replace(BOARD, step_mm=0.5)), camera, WATER)
    assert (np.sqrt((found.residual_mm**2).mean(0)) < [1.2e-4, 1.2e-4, 3e-3]).all()
    for name in ("plane_turn_x_rad", "plane_turn_y_rad"):
        assert abs(found.values[name] - TRUTH[name]) < 3 * found.std[name] < 1e-3


def test_too_few_dots():
    camera = lens_space()
    dots = dots_of(camera, planes=(-1.0, 1.0))
    with pytest.raises(PlenoPIVError, match=r"calibration.planes: only 30 dots are seen whole; 58 or more are needed"):
        fit_optics(dots, camera, WATER)


def images(*z_mm):
    return [TargetImage(f"target_{k}.tif", z, np.zeros((2, 2))) for k, z in enumerate(z_mm)]


def test_all_planes_at_one_depth():
    with pytest.raises(PlenoPIVError, match=r"^calibration.planes: all 3 are at z = 1.5 mm; give images of the target"):
        _check_planes(images(1.5, 1.5, 1.5))


def test_two_planes_at_one_depth():
    with pytest.raises(PlenoPIVError, match=r"^calibration.planes: target_0.tif and target_2.tif are both at 1.5 mm$"):
        _check_planes(images(1.5, 0.0, 1.5))
    _check_planes(images(1.5, 0.0))


def test_planes_out_of_order():
    message = (
        "^calibration.planes: out of order: target_2.tif is said to be at 0 mm and target_1.tif at 1 mm, but the "
        "images show the first nearer to the camera; z is positive toward the camera$"
    )
    with pytest.raises(PlenoPIVError, match=message):
        _check_order(images(-1.0, 1.0, 0.0), [-1.0, 0.0, 1.0])
    _check_order(images(-1.0, 1.0, 0.0), [-1.0, 1.0, 0.0])


def test_depths_whose_signs_are_turned():
    with pytest.raises(PlenoPIVError, match=r"z_mm grows away from the camera in all of them; .*: turn the signs"):
        _check_order(images(-1.0, 0.0, 1.0), [1.0, 0.0, -1.0])


def test_a_plane_without_a_depth():
    with pytest.raises(PlenoPIVError, match=r"^target_1.tif: its dots have no depth; is it in the reach of the camera"):
        _check_order(images(-1.0, 0.0, 1.0), [-1.0, np.nan, 1.0])


def residuals(*mean_um):
    """Planes whose mean residuals are such along z, or along x, y, z."""
    means = [mean if isinstance(mean, tuple) else (0.0, 0.0, mean) for mean in mean_um]
    return [
        PlaneResidual(f"target_{k}.tif", float(k), 20, 20, (0.3, 0.3, abs(mean[2])), mean)
        for k, mean in enumerate(means)
    ]


def others(*rms_z_um):
    return [(0.3, 0.3, rms) for rms in rms_z_um]


def test_a_plane_that_the_others_contradict():
    message = (
        "^calibration.planes: target_1.tif is said to be at z = 1 mm; by the other planes it is at 1.200 mm: correct "
        "its z_mm, or leave the image out$"
    )
    with pytest.raises(PlenoPIVError, match=message):
        _check_agreement(residuals(900.0, 200.0, -300.0, 100.0), others(300.0, 4.0, 200.0, 150.0))
    _check_agreement(residuals(5.0, 31.0, -30.0, 1.0), others(*[4.0] * 4))  # within eight times the others' RMS
    _check_agreement(residuals(0.0, 19.0, 0.0, 0.0), others(*[0.1] * 4))  # 0.02 mm are no matter
    _check_agreement(residuals(5.0, 200.0, -30.0), others(*[4.0] * 3))  # of three planes any one may be wrong
    _check_agreement(residuals(5.0, float("nan"), -30.0, 1.0), others(*[4.0] * 4))  # of no dot seen whole


def test_three_planes_that_disagree_are_warned_of():
    """Which of them is wrong nobody knows; dots a few um off, or as far as they are known, are no matter."""

    def optics(x_mm, z_mm, planes):
        off = np.random.default_rng(0).standard_normal((60, 3)) * (x_mm, 1e-3, z_mm)
        without = dict.fromkeys(range(planes), np.zeros(3))
        return SimpleNamespace(residual_mm=off, used=np.ones(60, bool), without_mm=without)

    dots = SimpleNamespace(std_mm=np.broadcast_to([0.2e-3, 0.2e-3, 5e-3], (60, 3)))
    with pytest.warns(match=r"the planes disagree: their dots lie 0\.0[45]. mm \(RMS\) along x"):
        _warn_of_three_planes(dots, optics(0.05, 0.01, 3))
    with pytest.warns(match=r"along z"):
        _warn_of_three_planes(dots, optics(0.01, 0.08, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _warn_of_three_planes(dots, optics(0.01, 0.03, 3))
        _warn_of_three_planes(dots, optics(0.05, 0.08, 4))


def test_a_plane_whose_dots_lie_beside_those_of_the_others():
    message = (
        "^calibration.planes: the dots of target_2.tif lie -0.800 mm along y from where the other planes have them: "
        "the target was moved aside, or another dot was taken for its origin; leave the image out$"
    )
    planes = residuals((0.0, 200.0, 0.0), 3.0, (0.0, -800.0, 2.0), (0.0, 190.0, 1.0))
    with pytest.raises(PlenoPIVError, match=message):
        _check_agreement(planes, [(0.3, 330.0, 4.0), (0.3, 330.0, 4.0), (0.3, 3.4, 4.0), (0.3, 330.0, 4.0)])


def test_figures_far_from_the_data_sheet_are_warned_of(fitted):
    """A pitch that is a tenth too small is made up for by microlenses of another focal length."""
    camera, (dots, right) = lens_space(), fitted
    stated = {"microlens_focal_length_mm": camera.microlens_focal_length_mm, "refractive_index": 1.333}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _compare_with_sheet(right, stated)
    wrong = replace(dots, laboratory_mm=dots.laboratory_mm * (0.9, 0.9, 1.0))
    found = fit_optics(wrong, camera, WATER)
    said = r"by the dots microlens_focal_length_mm is 0\.3\d+, \d+ standard deviations .* z_mm"
    with pytest.warns(PlenoPIVWarning, match=said):
        _compare_with_sheet(found, stated)


def test_a_plane_that_is_elsewhere_is_told_by_the_others_residuals():
    camera = lens_space()
    dots = dots_of(camera)
    dots.laboratory_mm[dots.plane == 2, 2] += 1.2
    found = fit_optics(dots, camera, WATER)
    assert found.without_mm[2][2] < 4e-3
    assert min(found.without_mm[k][2] for k in (0, 1, 3, 4)) > 0.05
    assert found.left_out_mm[dots.plane == 2, 2].mean() == pytest.approx(-1.2, abs=0.01)


def test_a_plane_that_was_moved_aside_is_told_likewise():
    dots = dots_of(lens_space())
    dots.laboratory_mm[dots.plane == 2, 0] += 0.3
    found = fit_optics(dots, lens_space(), WATER)
    assert found.without_mm[2][0] < 3e-4
    assert min(found.without_mm[k][0] for k in (0, 1, 3, 4)) > 0.02
    assert found.left_out_mm[dots.plane == 2, 0].mean() == pytest.approx(-0.3, abs=0.01)


def test_the_lens_that_stands_for_a_camera():
    """Pitch and distance of micro-images give the distance of the plane that the middles of all views share."""
    lattice = Lattice("hexagonal", 0.0773, 0.01, (0.02, -0.01))
    fit = lattice_fit(lattice, 14.0 * (1 + 0.308 / 110.0))
    camera = lens_space_camera(SHEET, fit, 6.2)
    assert camera.main_lens.image_distance_mm == pytest.approx(110.0)
    assert camera.main_lens.magnification == SHEET.main_lens.magnification
    assert camera.image_scale == pytest.approx(0.308 / 110.0)
    assert camera.aperture_radius_px == pytest.approx(6.2)
    assert camera.rim is None
    with_rim = lens_space_camera(
        SHEET, lattice_fit(lattice, 14.0 * (1 + 0.308 / 110.0), LensRim(9.0, 0.1, (1.0, -2.0))), 6.2
    )
    wider = SHEET.image_scale / camera.image_scale  # places of the main lens go with the distance
    assert with_rim.rim == LensRim(9.0 * wider, 0.1 * wider, (1.0 * wider, -2.0 * wider))
    assert camera.lattice.rotation_rad == lattice.rotation_rad
    of_stated = lattice.pitch_mm * (1 + SHEET.image_scale)
    assert camera.lattice.pitch_mm * (1 + camera.image_scale) == pytest.approx(of_stated)


@pytest.mark.parametrize("pitch_mm", [0.0768, 0.0772])
def test_a_pitch_of_another_array(pitch_mm):
    array = replace(SHEET, lattice=Lattice("hexagonal", pitch_mm))
    with pytest.raises(PlenoPIVError, match=r"^camera.microlens_array.pitch_mm: micro-images are .* pitches apart"):
        lens_space_camera(array, lattice_fit(array.lattice, 14.0 * (1 + 0.308 / 100.0)), 6.2)


def lattice_fit(lattice, pitch_px, rim=None):
    """A fit of which only the lattice and the micro-images' pitch matter."""
    known = {"lattice": lattice, "image_pitch_px": pitch_px, "rim": rim}
    found = object.__new__(LatticeFit)
    for field in fields(LatticeFit):
        object.__setattr__(found, field.name, known.get(field.name, 0))
    return found


PLACES = np.array([[0.0, 0.0, 0.0], [0.5, 0.1, -0.7], [-0.6, 0.4, 1.1]])


@pytest.fixture
def seen_at(monkeypatch):
    """Where points of the laboratory have their images in lens space, its origin and turn set: by rays, without the
    polynomials that a map fits to them."""
    monkeypatch.setattr(module, "space_map", lambda model, camera, limits: (model, camera))

    def seen(places, *later):
        model, camera = calibrated().space(((-1.0, 1.0),) * 3, *later)
        return images_of(places, model, camera).place_mm

    return seen


@pytest.mark.parametrize("axis", range(3))
def test_the_laboratory_s_origin_is_a_point_of_the_target_s_frame(seen_at, axis):
    """What is at 0 in the laboratory is where its origin was put, at +0.4 mm along one axis of the target."""
    origin = np.zeros(3)
    origin[axis] = 0.4
    np.testing.assert_allclose(seen_at(PLACES, tuple(origin.tolist())), seen_at(PLACES + origin), atol=1e-12)
    step = (seen_at(origin[None]) - seen_at(np.zeros((1, 3))))[0]
    assert step[axis] > 0.25  # toward the same side in lens space: 0.4 mm, in depth over the fluid's index


def test_the_laboratory_s_axes_are_turned_counter_clockwise(seen_at):
    """At 90 degrees what lies along +x of the laboratory lies along +y of the target, seen from the camera."""
    along_x, along_y = np.array([[0.5, 0.0, 0.3]]), np.array([[0.0, 0.5, 0.3]])
    quarter = (0.0, 0.0, 0.0), 90.0
    np.testing.assert_allclose(seen_at(along_x, *quarter), seen_at(along_y), atol=1e-12)
    np.testing.assert_allclose(seen_at(along_y, *quarter), seen_at(along_x * [-1, 1, 1]), atol=1e-12)
    moved = seen_at(along_x, (0.2, 0.0, 0.0), 90.0)
    np.testing.assert_allclose(moved, seen_at(along_y + np.array([0.2, 0.0, 0.0])), atol=1e-12)
