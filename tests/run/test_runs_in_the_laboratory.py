"""Runs whose x, y, z are the laboratory's: one map from file to results, and no other on resume."""

import json
import shutil
import tomllib

import h5py
import numpy as np
import pytest
import tomli_w
from conftest import VELOCITY_M_S, record
from runs import without_report

import plenopiv
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.cli import main
from plenopiv.device.backend import CPU
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.io.volumes import read_volume, volume_in_laboratory
from plenopiv.reconstruction.resampling import resampled
from plenopiv.report.document import page
from plenopiv.run import space as of_experiment
from plenopiv.run.compared import compare
from plenopiv.run.kept import KeptVolumes
from plenopiv.run.light_field_images import depths
from plenopiv.run.preview import cropped, preview
from plenopiv.run.space import check_view

N = 1.333
SHIFT_MM = np.array([12.0, -7.0, 30.0])  # of the laboratory's origin: no depth of the camera's is like its own
LIMITS = {"x_mm": [11.3, 12.7], "y_mm": [-7.6, -6.4], "z_mm": [28.0, 32.0]}
VOXEL_MM = (36 / 2100, 36 / 2100, 0.1)
TURN = np.radians(0.3)
MATRIX = np.array([[np.cos(TURN), -np.sin(TURN), 0.0], [np.sin(TURN), np.cos(TURN), 0.0], [0.0, 0.0, 1 / N]])


def space(shift=SHIFT_MM):
    points = np.random.default_rng(0).uniform(-4, 4, (200, 3)) + shift
    return SpaceMap.fitted(points, (points - shift) @ MATRIX.T, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording in the camera's frame, and an experiment file that has its volume in the laboratory."""
    folder = record(tmp_path_factory.mktemp("laboratory") / "recording").directory
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["volume"] = LIMITS | {"voxel_mm": list(VOXEL_MM)}
    tables["medium"] = {"refractive_index": N, "fluid_mm": 40.0}
    tables["reconstruction"] = {"iterations": 3}
    tables["output"] = {"volumes": True}
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return folder


@pytest.fixture(autouse=True)
def known(monkeypatch):
    """The map, as if the experiment's medium gave it, and no reports, which take half of a small run."""
    without_report(monkeypatch)
    monkeypatch.setattr(of_experiment, "space_of", lambda experiment, recording: space())


@pytest.fixture(scope="module")
def results(folder):
    with pytest.MonkeyPatch.context() as patch:
        without_report(patch)
        patch.setattr(of_experiment, "space_of", lambda experiment, recording: space())
        return plenopiv.process(Experiment.load(folder / "experiment.toml"))


def test_velocities_are_the_laboratory_s(results):
    field = results.velocity.isel(time=0)
    expected = np.linalg.solve(MATRIX, VELOCITY_M_S)
    found = np.array([float(field[name].median()) for name in "uvw"])
    per_voxel = np.array(VOXEL_MM) * 1e-3 / 0.0005
    np.testing.assert_allclose((found - expected) / per_voxel, 0, atol=0.15)
    for axis, (lo, hi) in LIMITS.items():
        assert lo < field[axis[0]].min() <= field[axis[0]].max() < hi
    assert field.attrs["frame"] == "laboratory"
    assert field.z.attrs["long_name"] == "z, in the laboratory"


def test_what_the_results_say_of_their_frame(results):
    summary = json.loads((results.directory / "summary.json").read_text())
    assert summary["frame"] == "laboratory"
    assert "x, y, z of the laboratory" in page("", "", laboratory=True)
    assert "+z toward the camera" in page("", "")


def test_kept_volumes_are_those_of_lens_space(results):
    volume = read_volume(results.directory / "volume-a.h5")
    assert volume.grid.voxel_mm == pytest.approx((*VOXEL_MM[:2], VOXEL_MM[2] / N), rel=1e-3)
    assert np.mean(volume.grid.limits_mm(), axis=1) == pytest.approx([0, 0, 0], abs=1e-3)


def test_a_kept_volume_is_exported_in_the_laboratory(results, tmp_path):
    kept, mesh = results.directory / "volume-a.h5", tmp_path / "volume.vtkhdf"
    assert main(["export", str(kept), str(mesh)]) == 0
    found = volume_in_laboratory(kept)
    assert found.grid == Experiment.load(results.directory / "experiment.toml").grid()
    expected = resampled(read_volume(kept), space().to_laboratory, found.grid)
    assert found.values.tobytes() == expected.values.tobytes()
    with h5py.File(mesh) as file:
        np.testing.assert_allclose(file["VTKHDF"].attrs["Origin"], found.grid.first_mm)
        assert file["VTKHDF/PointData/intensity"][:].sum() == pytest.approx(found.values.sum(), rel=1e-5)


def test_a_damaged_map_of_a_kept_volume(results, tmp_path):
    for name, value in (("degree", 9), ("half_mm", [1.0, 0.0, 1.0]), ("shape", [0, 1, 1]), ("centre_mm", [1.0])):
        shutil.copy(results.directory / "volume-a.h5", tmp_path / "a.h5")
        with h5py.File(tmp_path / "a.h5", "a") as file:
            file["to_laboratory"].attrs[name] = value
        with pytest.raises(PlenoPIVError, match=r"a.h5: is no volume of plenopiv or is damaged \(its (map|grid)"):
            volume_in_laboratory(tmp_path / "a.h5")


@pytest.mark.full
def test_correlating_kept_volumes_again_gives_the_same_bits(results, tmp_path):
    again = plenopiv.correlate(results.directory, out=tmp_path / "again")
    assert again.summary["frame"] == "laboratory"
    found = read_velocity(tmp_path / "again" / "velocity.nc")
    for name, values in results.velocity.data_vars.items():
        assert values.values.tobytes() == found[name].values.tobytes(), name


@pytest.mark.full
def test_another_map_is_another_calibration(results, folder, monkeypatch):
    experiment = Experiment.load(folder / "experiment.toml")
    monkeypatch.setattr(
        of_experiment, "space_of", lambda experiment, recording: space(SHIFT_MM + np.array([0.0, 0.0, 0.1]))
    )
    with pytest.raises(PlenoPIVError, match=r"another calibration \(calibration.space: was "):
        plenopiv.process(experiment)
    with pytest.raises(PlenoPIVError, match="give another calibration now"):
        KeptVolumes.of(results.directory).chain(experiment, experiment.recording(), lambda *stage: None, CPU)


def test_a_volume_that_the_camera_does_not_see(folder):
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    planes = [{"image": f"target_{k}.tif", "z_mm": 28.0 + k} for k in range(2)]  # read by nobody
    del tables["medium"]
    tables["calibration"] = {"target": "dots", "pitch_mm": 0.6, "dot_mm": 0.2, "origin_dot_mm": 0.3, "planes": planes}
    for key, limits, words in (
        ("x_mm", [0.0, 1.4], r"experiment.toml: volume: 100 % of it is seen by no view; reduce x_mm"),
        ("z_mm", [28.0, 228.0], r"volume.z_mm: 148.537 mm in lens space is not in front of the main lens, which is at"),
    ):
        other = Experiment.from_dict({**tables, "volume": tables["volume"] | {key: limits}}, folder / "experiment.toml")
        with pytest.raises(PlenoPIVError, match=words):
            check_view(other, other.camera(), space())


def test_results_of_two_frames_are_not_compared(results, tmp_path):
    other = tmp_path / "velocity.nc"
    results.velocity.assign_attrs(frame="camera").to_netcdf(other, engine="h5netcdf")
    with pytest.raises(PlenoPIVError, match=r"frame of the laboratory, .* in that of the camera"):
        compare(results.directory, other)


def test_depths_of_refocused_pictures_are_the_camera_s(folder):
    found = depths(Experiment.load(folder / "experiment.toml"))
    assert -2 / N < found[0] < found[-1] < 2 / N  # of 28 to 32 mm in the laboratory


@pytest.mark.full
def test_a_recording_of_the_laboratory_is_checked(folder, capsys):
    assert main(["check", str(folder / "experiment.toml")]) == 0
    assert "experiment.toml: good\n" in capsys.readouterr().out


def test_a_preview_lies_about_the_optical_axis(folder):
    experiment = Experiment.load(folder / "experiment.toml")
    part, tables = cropped(experiment, space())
    small = Experiment.from_dict(tables, experiment.path)
    assert part.columns <= experiment.camera().sensor.columns
    for (lo, hi), middle in zip(small.grid().limits_mm(), SHIFT_MM, strict=True):
        assert lo < middle < hi
        assert hi - middle == pytest.approx(middle - lo, rel=0.3)


@pytest.mark.full
def test_a_preview_measures_the_laboratory(folder):
    found = preview(Experiment.load(folder / "experiment.toml"))
    measured = np.array([float(found.velocity[name].median()) for name in "uvw"])
    per_voxel = np.array(VOXEL_MM) * 1e-3 / 0.0005
    np.testing.assert_allclose((measured - np.linalg.solve(MATRIX, VELOCITY_M_S)) / per_voxel, 0, atol=0.5)
    assert found.summary["frame"] == "laboratory"
    assert main(["info", str(found.directory / "experiment.toml")]) == 0
