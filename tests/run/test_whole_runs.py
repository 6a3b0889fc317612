"""From raw images to velocity.nc and report: signs, units, files, refusals."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
import xarray as xr
from conftest import VELOCITY_M_S, record

import plenopiv
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.series_file import open_series
from plenopiv.io.volumes import read_volume
from plenopiv.run.calibrated import calibrated_chain

VOXEL_M_S = np.array([0.0171428571, 0.0171428571, 0.077]) * 1e-3 / 0.0005


def middle_error_voxels(velocity):
    """Median error of a field in voxels, by axis."""
    measured = np.array([float(velocity[name].median()) for name in "uvw"])
    return (measured - VELOCITY_M_S) / VOXEL_M_S


@pytest.mark.parametrize("orientation", ["upright", "sensor"])
@pytest.mark.usefixtures("without_report")
def test_signs_and_units_from_particle_to_velocity(recorded, upright, tmp_path, orientation):
    result = upright
    if orientation == "sensor":
        folder = record(tmp_path / "recording", orientation="sensor").directory
        turned = tifffile.imread(folder / "a.tif")[::-1, ::-1]
        assert np.corrcoef(turned.ravel(), tifffile.imread(recorded / "a.tif").ravel())[0, 1] > 0.9
        result = plenopiv.process(plenopiv.load(folder / "experiment.toml"))
    assert np.abs(middle_error_voxels(result.velocity)) == pytest.approx([0, 0, 0], abs=0.1)
    with xr.open_dataset(result.directory / "velocity.nc", engine="h5netcdf") as stored:
        assert stored.u.dims == ("time", "z", "y", "x")
        assert stored.u.units == "m s-1"
        assert stored.x.units == "mm"
        assert float(stored.time.values[0]) == pytest.approx(0.00025)
        assert all((np.diff(stored[axis]) > 0).all() for axis in "xyz")
        assert middle_error_voxels(stored) == pytest.approx(middle_error_voxels(result.velocity))


def test_volumes_of_all_frames_where_asked(upright, finished):
    for name in ("a", "b"):
        volume = read_volume(upright.directory / f"volume-{name}.h5")
        kept = upright.summary["reconstruction"][f"{name}.tif"]["voxels_kept"]
        assert np.count_nonzero(volume.values) == volume.column.size == kept > 0
    assert not list(finished.experiment.output_directory.glob("volume-*"))


def test_kept_volumes_give_the_same_vectors_bit_for_bit(upright):
    """With the camera calibrated anew, from the experiment file in the results folder."""
    experiment = Experiment.load(upright.directory / "experiment.toml")
    chain, recording, _ = calibrated_chain(experiment, experiment.recording())
    a, b = (read_volume(upright.directory / f"volume-{name}.h5") for name in "ab")
    again = chain.velocity(a, b, recording.dt_s, recording.mid_time_s(0))
    for name, values in again.data_vars.items():
        assert values.values.tobytes() == upright.velocity[name].values.tobytes(), name


def test_the_results_folder(finished, capsys):
    experiment, out, err, summary = finished
    assert "memory: about" in err
    folder = experiment.output_directory
    moved, words, velocity, report = out.splitlines()
    largest = ", ".join(f"{d:.2g}" for d in summary["not_in_images"]["largest_displacement_voxels"])
    assert moved.startswith(f"displacements of up to ({largest}) voxels along (x, y, z), ")
    assert 'dt = 0.0005 s, orientation "upright"' in moved
    assert next(iter(summary)) == "not_in_images"
    assert summary["quality"] == "good"
    assert summary["set_aside"] == summary["findings"] == []
    assert re.fullmatch(r"\d+ vectors, \d+\.\d % replaced, (no|\d+) warnings?", words)
    assert velocity == str(folder / "velocity.nc")
    assert report.startswith(str(folder / "report.html"))
    assert {path.name for path in folder.iterdir()} == {
        "velocity.nc",
        "summary.json",
        "experiment.toml",
        "report.html",
        "figures",
        "manifest.jsonl",
    }
    assert {"velocity.png", "velocity.pdf", "residuals.pdf"} < {path.name for path in (folder / "figures").iterdir()}
    page = (Path(__file__).parents[2] / "docs" / "guide.md").read_text(encoding="utf-8")
    keys = {*summary, *summary["not_in_images"], *summary["calibration"], *summary["reconstruction"]["a.tif"]}
    assert {key for key in keys if f"`{key}`" not in page} <= {"lattice", "microlenses"}
    assert summary["calibration"]["residual_px"] < 0.05
    assert summary["reconstruction"]["a.tif"]["candidate_share"] < 0.5
    residuals = summary["reconstruction"]["b.tif"]["residual_counts_by_iteration"]
    assert len(residuals) == experiment.reconstruction.iterations
    assert set(summary["timings_s"]) >= {"calibration", "reconstruction", "correlation"}
    assert sys.platform == "win32" or 0.05 < summary["peak_memory_gb"]["correlation"] < 4
    resolved = Experiment.load(folder / "experiment.toml")
    assert resolved.grid() == experiment.grid()
    page = (folder / "report.html").read_text()
    assert all(f'id="{name}"' in page for name in ("scene", "slices", "volume", "views", "refocus"))
    assert re.search(r"experiment\.toml · evaluated \d{4}-\d\d-\d\d \d\d:\d\d UTC", page)
    assert summary["versions"]["plenopiv"] == plenopiv.__version__
    assert summary["versions"]["numpy"] == np.__version__
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert main(["run", str(experiment.path)]) == 0
    assert "nothing has changed; nothing to do" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_three_frames_make_two_times(masked):
    """The third one is the first one again."""
    field = open_series(masked / "velocity.nc")
    assert field.time.values == pytest.approx([0.00025, 0.00075])
    there, back = (np.array([float(field[n].isel(time=k).median()) for n in "uvw"]) for k in (0, 1))
    assert there / VOXEL_M_S == pytest.approx(-back / VOXEL_M_S, abs=0.1)
    assert there / VOXEL_M_S == pytest.approx(VELOCITY_M_S / VOXEL_M_S, abs=0.3)


def test_an_exposure_without_particles_is_named_and_nothing_is_written(experiment, capsys):
    rng = np.random.default_rng(0)
    dark = rng.normal(60, 1.5, tifffile.imread(experiment.folder / "b.tif").shape)
    tifffile.imwrite(experiment.folder / "b.tif", np.clip(np.rint(dark), 0, 4095).astype(np.uint16))
    assert main(["run", str(experiment.path)]) == 2
    error = capsys.readouterr().err.strip().split("\n")[-1]
    assert error.startswith("plenopiv: error: b.tif is underexposed")
    assert not experiment.output_directory.exists()


@pytest.mark.full
@pytest.mark.usefixtures("without_report")
def test_saturated_frames_and_large_displacements_are_warned_about_and_kept(experiment):
    image = tifffile.imread(experiment.folder / "a.tif")
    bright = np.where(image > np.percentile(image, 99), 4095, image).astype(np.uint16)
    tifffile.imwrite(experiment.folder / "a.tif", bright)
    tables = experiment.model_dump(mode="json", by_alias=True, exclude_none=True)
    tables["reconstruction"]["iterations"] = 1
    with pytest.warns(plenopiv.PlenoPIVWarning, match="saturated"):
        result = plenopiv.process(Experiment.from_dict(tables, experiment.path))
    assert any("saturated" in line and "%" in line for line in result.summary["warnings"])


@pytest.mark.full
@pytest.mark.usefixtures("without_report")
def test_full_mart_agrees_with_drt_mart(experiment):
    tables = experiment.model_dump(mode="json", by_alias=True, exclude_none=True)
    tables["reconstruction"] |= {"method": "mart", "iterations": 3, "relaxation": 1.0}
    tables["output"]["directory"] = "full"
    result = plenopiv.process(Experiment.from_dict(tables, experiment.path))
    assert result.summary["reconstruction"]["a.tif"]["candidate_share"] == 1.0
    assert np.abs(middle_error_voxels(result.velocity)) == pytest.approx([0, 0, 0], abs=0.1)


def test_a_score_reaches_the_report(upright):
    assert "largest w (m/s)" in (upright.directory / "report.html").read_text()


def test_an_interrupted_run_leaves_nothing(experiment):
    def stop(stage, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plenopiv.process(experiment, progress=stop)
    assert not experiment.output_directory.exists()


def test_a_dark_frame_fails_before_its_neighbour_is_worked_on(experiment):
    (experiment.folder / "b.tif").unlink()
    with pytest.raises(PlenoPIVError, match=r"b\.tif"):
        plenopiv.process(experiment, progress=lambda *_: pytest.fail("work began"))


@pytest.mark.full
@pytest.mark.usefixtures("without_report")
def test_gradients_are_written_on_request(experiment):
    from plenopiv.statistics import velocity_gradients

    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["output"]["gradients"] = True
    asked = Experiment.from_dict(tables, experiment.path)
    velocity = plenopiv.process(asked).velocity
    alone = velocity_gradients(velocity.isel(time=0), asked.correlation.settings())
    for name in ("du_dz", "vorticity_y", "divergence_std", "q"):
        assert velocity[name].dims == ("time", "z", "y", "x")
        np.testing.assert_array_equal(velocity[name].values[0], alone[name].values)
    assert velocity.time.attrs["units"] == "s"
    assert velocity.time.attrs["long_name"] == asked.recording().time_meaning
    assert velocity.x.attrs["units"] == "mm"
