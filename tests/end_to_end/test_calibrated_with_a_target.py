"""A camera before a tank: calibrated with images of a target, and a flow measured with it, in the tank's frame."""

import json
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from runs import made_once, without_report

from plenopiv.calibration.target.board import Board, TargetImage
from plenopiv.calibration.target.calibrated import calibrate_target
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import on_disc, rotation
from plenopiv.cli import main
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.io.calibration_file import load_calibration
from plenopiv.lattice import Lattice
from plenopiv.run.target import target_calibration
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import Shear
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_images import target_image
from plenopiv.simulation.real_recording import Extras, TargetPlanes, simulate_real_recording
from plenopiv.simulation.targets import DotTarget

pytestmark = pytest.mark.full

TRUE = PlenopticCamera(
    MainLens(50.0, 22.0, -1.0), Lattice("hexagonal", 0.077, 0.006, (0.01, -0.02)), 0.308,
    Sensor(480, 400, 0.0055, 12, 60),
)  # fmt: skip
CAMERA = RealCamera.of(
    TRUE, stop_mm=10.0, distortion=0.006, gap_tilt=0.01, gap_tilt_direction_deg=30.0,
    medium=Medium(1.333, 40.0, 8.0, 1.52), pose=Pose(0.5, (0.06, -0.04, 0.3), (0.2, -0.15)),
)  # fmt: skip
SHEET = PlenopticCamera(MainLens(50.8, 22.5, -0.98), Lattice("hexagonal", 0.077), 0.3085, TRUE.sensor)  # as delivered
FLOW = Shear(45.0, "x", "z", (0.05, -0.06, 0.15))
DOTS = DotTarget(0.4, 0.16, 0.28, 0.22)
DEPTHS_MM = (-3.0, -1.5, 0.0, 1.5, 3.0)


def recorded(folder):
    simulate_real_recording(
        folder / "tank", CAMERA, FLOW, dt_s=5e-4, volume_mm=((-0.7, 0.7), (-0.6, 0.6), (-2.4, 2.4)), sheet=SHEET,
        windows=((48, 48, 20), (32, 32, 16)), rays=4000, seed=3,
        extras=Extras(TargetPlanes(DOTS, DEPTHS_MM, samples=100), dark=True),
    )  # fmt: skip
    assert main(["calibrate", str(folder / "tank" / "experiment.toml")]) == 0
    return folder / "tank"


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    """A recording with five planes of a target, calibrated."""
    return made_once(tmp_path_factory, "with-target", recorded)


@pytest.fixture
def own(tank, tmp_path):
    """The same in a folder of its own, not calibrated; a function that changes its file's [calibration]."""
    shutil.copytree(tank, tmp_path / "tank")
    for name in ("calibration.toml", "lattice.toml"):
        (tmp_path / "tank" / name).unlink()
    file = tmp_path / "tank" / "experiment.toml"

    def changed(**keys):
        tables = tomllib.loads(file.read_text())
        tables["calibration"] |= keys
        file.write_text(tomli_w.dumps(tables))
        return file

    return changed


@pytest.fixture
def one_line(capsys):
    """The one line of ``plenopiv calibrate`` on a file that must be refused; nothing is written."""

    def refused(file):
        before = set(file.parent.iterdir())
        capsys.readouterr()
        assert main(["--quiet", "calibrate", str(file)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert set(file.parent.iterdir()) == before
        return err

    return refused


def test_left_out_dots_lie_where_they_are(tank):
    found, _ = load_calibration(tank / "calibration.toml")
    assert sum(plane.whole for plane in found.planes) > 80
    whole = np.array([plane.whole for plane in found.planes])
    rms = np.sqrt(np.average(np.square([plane.rms_um for plane in found.planes]), axis=0, weights=whole))
    assert (rms < [0.8, 0.8, 6.0]).all()
    assert (tank / "calibration.png").stat().st_size > 10_000


def test_lengths_are_found_within_three_standard_deviations(tank):
    found, _ = load_calibration(tank / "calibration.toml")
    x, y, _ = CAMERA.pose.origin_mm
    for name, exact in {
        "focal_length_mm": 50.0, "image_distance_mm": 100.0, "refractive_index": 1.333, "distortion": 0.006,
        "turn_x_rad": np.radians(0.2), "turn_y_rad": np.radians(-0.15), "turn_z_rad": np.radians(0.5), "x_mm": x,
        "y_mm": y, "magnification": -1.0,
    }.items():  # fmt: skip
        assert abs(found.values[name] - exact) < 3 * found.std[name] + 1e-4, name
    assert found.values["magnification"] == pytest.approx(-1.0, abs=5e-4)


def test_a_calibration_is_the_same_when_it_is_read(tank, own):
    """To the last bit: a series is resumed where it says the same of the camera."""
    found, inputs = load_calibration(tank / "calibration.toml")
    experiment = Experiment.load(own())
    assert repr(target_calibration(experiment, experiment.recording())) == repr(found)
    assert load_calibration(experiment.folder / "calibration.toml")[1] == inputs


def test_a_flow_is_measured_in_the_frame_of_the_target(tank, tmp_path, monkeypatch):
    without_report(monkeypatch)
    shutil.copytree(tank, tmp_path / "tank")
    assert main(["run", str(tmp_path / "tank" / "experiment.toml")]) == 0
    results = tmp_path / "tank" / "results"
    summary = json.loads((results / "summary.json").read_text())
    assert summary["frame"] == "laboratory"
    assert summary["calibration"]["target_residual_um"][2] < 6
    assert not any("aperture_mm" in line for line in summary["warnings"])
    field = read_velocity(results / "velocity.nc").isel(time=0).transpose("z", "y", "x", ...)
    z, y, x = np.meshgrid(*(field[axis].values for axis in "zyx"), indexing="ij")
    exact = FLOW(np.column_stack([x.ravel(), y.ravel(), z.ravel()])).T
    voxel_m_s = np.array(Experiment.load(results / "experiment.toml").volume.voxel_mm) * 1e-3 / 5e-4
    far = np.abs(z.ravel() + CAMERA.pose.origin_mm[2]) > 0.7  # from focus, where depths are not resolved
    for k, name in enumerate("uvw"):
        error = (field[name].values.ravel() - exact[k]) / voxel_m_s[k]
        assert abs(error[far].mean()) < 0.05, name
        assert np.sqrt((error**2).mean()) < 0.15, name
    slope, _ = np.polyfit(exact[0], field["u"].values.ravel(), 1)
    assert slope == pytest.approx(1.0, abs=0.03)


def test_a_traverse_whose_zero_is_far_from_focus(tank, own):
    """Behind the camera even: the same rays, from places whose z is the traverse's."""
    planes = [{"image": f"target_{k:02d}.tif", "z_mm": z - 210.0} for k, z in enumerate(DEPTHS_MM)]
    file = own(planes=planes)
    assert main(["--quiet", "calibrate", str(file)]) == 0
    (near, _), (far, _) = (load_calibration(folder / "calibration.toml") for folder in (tank, file.parent))
    places = np.array([[0.0, 0.0, 0.0], [0.6, -0.5, 2.4], [-0.6, 0.5, -2.4]])
    aperture = on_disc(8.0, 9)
    expected, found = near.model.trace(places, aperture), far.model.trace(places - [0.0, 0.0, 210.0], aperture)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-3)
    assert far.values["fluid_mm"] == pytest.approx(near.values["fluid_mm"] - 210.0, abs=0.05)


def test_planes_in_another_order_than_the_images(own, one_line):
    planes = [{"image": f"target_{k:02d}.tif", "z_mm": z} for k, z in enumerate((-3.0, -1.5, 1.5, 0.0, 3.0))]
    words = "calibration.planes: out of order: target_03.tif is said to be at 0 mm and target_02.tif at 1.5 mm"
    assert words in one_line(own(planes=planes))


def test_a_plane_that_was_not_where_it_is_said_to_be(own, one_line):
    planes = [{"image": f"target_{k:02d}.tif", "z_mm": z} for k, z in enumerate((-3.0, -1.5, 1.2, 1.5, 3.0))]
    line = one_line(own(planes=planes))
    assert "target_02.tif is said to be at z = 1.2 mm; by the other planes it is at " in line
    assert float(line.split("it is at ")[1].split(" mm")[0]) == pytest.approx(0.0, abs=0.05)


def test_no_dot_is_as_large_as_the_origin_s(own, one_line):
    line = one_line(own(origin_dot_mm=0.38, x_dot_mm=0.37))
    assert "none shows the dot of calibration.origin_dot_mm with that of x_dot_mm beside it" in line


def seen_off_square(z_mm, about_x_deg, about_y_deg):
    """The tank's camera, and in place of its laboratory the frame of a target at ``z_mm`` of the traverse, turned."""
    pose = CAMERA.pose
    axes = pose.axes @ rotation(np.radians(about_x_deg), np.radians(about_y_deg), 0.0)
    about_x, about_y, about_z = np.degrees([
        np.arctan2(axes[2, 1], axes[2, 2]), -np.arcsin(axes[2, 0]), np.arctan2(axes[1, 0], axes[0, 0])
    ])  # fmt: skip
    return replace(CAMERA, pose=Pose(about_z, tuple(pose.to_camera([0.0, 0.0, z_mm])), (about_x, about_y)))


def test_a_target_that_is_not_square_to_its_traverse():
    """What is left in depth was 7 um; z is the traverse's, along which dots tell to thousandths of a degree."""
    rng, images = np.random.default_rng(1), []
    for z in DEPTHS_MM:
        light = target_image(seen_off_square(z, 0.6, -0.4), DOTS, 0.0, 2000.0, samples=100)
        images.append(TargetImage(f"at {z:g} mm", z, np.rint(light + rng.normal(0, 3, light.shape) + 60)))
    found = calibrate_target(images, Board(0.4, 0.16, 0.28, 0.22), TRUE, CAMERA.medium)
    assert np.sqrt(np.mean([plane.rms_um[2] ** 2 for plane in found.planes])) < 4
    for axis, off_deg, tilt_deg in zip("xy", (0.6, -0.4), CAMERA.pose.tilt_deg, strict=True):
        off, std = (np.degrees(of[f"plane_turn_{axis}_rad"]) for of in (found.values, found.std))
        assert abs(off - off_deg) < 3 * std < 0.2
        assert np.degrees(found.values[f"turn_{axis}_rad"]) == pytest.approx(tilt_deg, abs=0.003)


def test_a_target_of_two_levels():
    """Columns of odd numbers 0.5 mm farther from the camera than the others, which are at the plane's z."""
    flat = RealCamera.of(TRUE, medium=CAMERA.medium)
    target = DotTarget(0.4, 0.16, 0.28, 0.22, step_mm=0.5)
    rng, images = np.random.default_rng(1), []
    for z in (-2.0, 0.0, 2.0):
        light = target_image(flat, target, z, 2000.0, samples=100)
        images.append(TargetImage(f"at {z:g} mm", z, np.rint(light + rng.normal(0, 3, light.shape) + 60)))
    rms = {}
    for step in (0.5, 0.0, -0.5):
        board = Board(0.4, 0.16, 0.28, 0.22, step)
        found = calibrate_target(images, board, TRUE, CAMERA.medium)
        rms[step] = np.sqrt(np.mean([plane.rms_um[2] ** 2 for plane in found.planes]))
    assert rms[0.5] < 8
    assert min(rms[0.0], rms[-0.5]) > 10 * rms[0.5]
