"""``plenopiv correlate``: the vectors of a whole run with other windows, from the volumes that a run kept."""

import json
import shutil
import signal
import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest
import tifffile
import tomli_w
from conftest import record, sequence
from runs import without_report

import plenopiv
from plenopiv.chain import Chain
from plenopiv.cli import main
from plenopiv.device.backend import CPU
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.io.series_file import open_series
from plenopiv.io.volumes import read_volume
from plenopiv.run import calibrated, kept
from plenopiv.run.judged import PairJudge
from plenopiv.run.kept import KeptVolumes
from plenopiv.simulation.simulated_recording import Seeding

WINDOWS = [[40, 40, 24], [32, 32, 20]]


@pytest.fixture(scope="module", autouse=True)
def _without_report():
    with pytest.MonkeyPatch.context() as patch:
        without_report(patch)
        yield


def with_windows(experiment, windows, directory):
    """The experiment with other windows and another results folder."""
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["correlation"]["windows"] = windows
    tables["output"] = {"directory": directory}
    return Experiment.from_dict(tables, experiment.path)


@pytest.fixture
def results(masked, tmp_path):
    """A copy that may be changed, in a copy of its recording."""
    shutil.copytree(masked.parent, tmp_path / "recording")
    return tmp_path / "recording" / "results"


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def same_bits(a, b):
    assert set(a.data_vars) == set(b.data_vars)
    for name in (*a.data_vars, *a.coords):
        assert a[name].values.tobytes() == b[name].values.tobytes(), name


@pytest.mark.full
def test_the_vectors_of_a_whole_run_with_these_windows_bit_for_bit(masked, results, capsys):
    experiment = Experiment.load(results.parent / "experiment.toml")
    unusable = experiment.recording().unusable
    assert unusable[100, 200]  # hot
    assert unusable[0, 0]  # masked
    whole = plenopiv.process(with_windows(experiment, WINDOWS, "whole"))
    before = contents(results)
    assert main(["correlate", str(results), "--windows", "40x40x24,32x32x20"]) == 0
    out = capsys.readouterr().out
    made = results.parent / "results-40x40x24-32x32x20"
    assert f"{made / 'velocity.nc'}\n" in out
    assert contents(results) == before
    same_bits(open_series(made / "velocity.nc"), open_series(whole.directory / "velocity.nc"))
    same_bits(read_velocity(made / "pairs/pair-0001.nc"), read_velocity(whole.directory / "pairs/pair-0001.nc"))
    resolved = tomllib.loads((made / "experiment.toml").read_text())
    assert resolved["correlation"]["windows"] == WINDOWS
    assert resolved["correlation"]["inner_window"] == [24, 24, 16]  # of the new last window
    assert Experiment.load(made / "experiment.toml").recording().names == ["a.tif", "b.tif", "c.tif"]
    summary = json.loads((made / "summary.json").read_text())
    assert summary["volumes_of"] == str(results)
    assert summary["reconstruction"] == whole.summary["reconstruction"]
    assert summary["quality"] == whole.summary["quality"]
    assert summary["vectors"] == whole.summary["vectors"]
    assert "reconstruction" not in summary["timings_s"]
    assert not list(made.glob("volume-*"))
    for name in ("a", "c"):  # copies of one image
        assert read_volume(results / f"volume-{name}.h5").values.size
    assert (results / "volume-a.h5").read_bytes() == (results / "volume-c.h5").read_bytes()
    assert main(["correlate", str(results), "--windows", "40x40x24,32x32x20"]) == 0
    assert "nothing to do" in capsys.readouterr().err
    with pytest.raises(PlenoPIVError, match=r"kept no volumes; set output\.volumes = true"):
        plenopiv.correlate(made, windows=WINDOWS)


def test_the_camera_is_that_of_the_volumes(masked, monkeypatch):
    """It is read, not calibrated again; a manifest without one is refused."""
    monkeypatch.setattr(calibrated, "find_lattice", lambda *given: pytest.fail("calibrated again"))
    volumes = KeptVolumes.of(masked)
    recording = volumes.experiment.recording()
    chain = volumes.chain(volumes.experiment, recording, lambda *stage: None, CPU)
    summary = volumes.summary["calibration"]
    assert chain.camera.lattice.offset_mm == tuple(summary["offset_mm"])
    assert chain.camera.lattice.pitch_mm == summary["pitch_mm"] != volumes.experiment.camera().lattice.pitch_mm
    del volumes.inputs["calibration"]["camera"]["lattice"]["pitch_mm"]
    with pytest.raises(PlenoPIVError, match=r"manifest\.jsonl: holds no calibrated camera; run again with --overwrite"):
        volumes.chain(volumes.experiment, recording, lambda *stage: None, CPU)


@pytest.mark.full
def test_other_keys_and_a_folder_of_ones_own(masked, tmp_path):
    found = plenopiv.correlate(masked, out=tmp_path / "own", overlap=0.3, fine_passes=1, windows=[[48, 48, 24]])
    assert found.directory == tmp_path / "own"
    resolved = Experiment.load(tmp_path / "own" / "experiment.toml").correlation
    assert (resolved.overlap, resolved.fine_passes, resolved.windows) == (0.3, 1, ((48, 48, 24),))
    assert found.velocity.sizes["time"] == 2


def test_sub_windows_that_the_experiment_file_states_stay(results):
    volumes = KeptVolumes.of(results)
    volumes.inputs["settings"]["correlation"]["inner_window"] = [24, 24, 12]
    tables = volumes.experiment.model_dump(by_alias=True, exclude_none=True)
    tables["correlation"]["inner_window"] = [24, 24, 12]
    stated = replace(volumes, experiment=Experiment.from_dict(tables, volumes.experiment.path))
    experiment, out = stated.with_correlation({"windows": WINDOWS, "overlap": 0.25})
    assert experiment.correlation.inner_window == (24, 24, 12)
    assert out.name == "results-40x40x24-32x32x20-overlap-0.25"
    with pytest.raises(PlenoPIVError, match=r"correlation.inner_window: \[24, 24, 12\] is larger than the last"):
        stated.with_correlation({"windows": [[32, 32, 16], [16, 16, 12]]})


def flipped(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def another_white(results):
    image = tifffile.imread(results.parent / "white.tif")
    image[50, 50] += 1
    tifffile.imwrite(results.parent / "white.tif", image)


def another_experiment(results):
    file = results / "experiment.toml"
    file.write_text(file.read_text().replace("focal_length_mm = 50.0", "focal_length_mm = 50.1"))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda r: flipped(r / "volume-b.h5"), "volume-b.h5: is damaged; the same plenopiv run makes it again"),
        (lambda r: (r / "volume-c.h5").unlink(), "volume-c.h5: is gone; the same plenopiv run makes it again"),
        (another_white, "white.tif: is another file than the one that the volumes of"),
        (lambda r: (r.parent / "dark.tif").unlink(), "dark.tif"),
        (another_experiment, "experiment.toml: is gone, or not as its run left it"),
        (lambda r: flipped(r / "manifest.jsonl"), "manifest.jsonl: is damaged"),
        (lambda r: (r / "manifest.jsonl").unlink(), "holds no finished run"),
        (lambda r: shutil.rmtree(r), "no such folder"),
    ],
)
def test_what_is_not_as_the_run_left_it_is_refused_before_any_work(results, spoil, words, capsys):
    spoil(results)
    before = contents(results.parent)
    assert main(["correlate", str(results), "--windows", "40x40x24,32x32x20"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert contents(results.parent) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--windows", "40x40x400"], "correlation.windows[0]: 400 voxels along z do not fit"),
        (["--windows", "40x40"], "--windows 40x40: give voxels along x, y, z"),
        (["--inner-window", "8x8x8,8x8x8"], "--inner-window 8x8x8,8x8x8: give voxels along x, y, z"),
        (["--overlap", "2"], "plenopiv: error: correlation.overlap: 2.0 is out of range"),
        (["--windows", "40x40x24", "--out", "RESULTS"], "holds the volumes; name another folder"),
    ],
)
def test_settings_that_cannot_be_used_are_one_line(masked, options, words, capsys):
    before = contents(masked.parent)
    assert main(["correlate", str(masked), *(o.replace("RESULTS", str(masked)) for o in options)]) == 2
    assert words in capsys.readouterr().err
    assert contents(masked.parent) == before


def test_a_key_that_is_none_is_refused(masked):
    with pytest.raises(PlenoPIVError, match=r"correlation\.window"):
        plenopiv.correlate(masked, window=WINDOWS)


@pytest.mark.full
def test_other_windows_in_the_same_folder_are_refused(masked, tmp_path):
    plenopiv.correlate(masked, out=tmp_path / "own", windows=[[48, 48, 24]], fine_passes=1)
    before = contents(tmp_path / "own")
    with pytest.raises(PlenoPIVError, match=r"settings\.correlation\.windows"):
        plenopiv.correlate(masked, out=tmp_path / "own", windows=[[40, 40, 24]], fine_passes=1)
    assert contents(tmp_path / "own") == before
    plenopiv.correlate(masked, out=tmp_path / "own", windows=[[40, 40, 24]], fine_passes=1, overwrite=True)
    assert Experiment.load(tmp_path / "own" / "experiment.toml").correlation.windows == ((40, 40, 24),)


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_what_was_finished_when_it_was_killed_is_kept(masked, tmp_path, monkeypatch):
    changed = {"windows": [[48, 48, 24]], "fine_passes": 1}
    whole = plenopiv.correlate(masked, out=tmp_path / "whole", **changed)
    killed = f"""
import os, signal, plenopiv
from plenopiv.chain import Chain
measured, velocity = [], Chain.velocity
def killing(self, *given):
    if measured:
        os.kill(os.getpid(), signal.SIGKILL)
    measured.append(given)
    return velocity(self, *given)
Chain.velocity = killing
plenopiv.correlate({str(masked)!r}, out={str(tmp_path / "ended")!r}, **{changed!r})
"""
    ended = subprocess.run([sys.executable, "-c", killed], capture_output=True, timeout=300, check=False)
    assert ended.returncode == -signal.SIGKILL
    assert not (tmp_path / "ended" / "velocity.nc").exists()
    measured, velocity = [], Chain.velocity
    monkeypatch.setattr(Chain, "velocity", lambda self, *given: measured.append(given) or velocity(self, *given))
    found = plenopiv.correlate(masked, out=tmp_path / "ended", **changed)
    assert len(measured) == 1
    assert (found.directory / "velocity.nc").read_bytes() == (whole.directory / "velocity.nc").read_bytes()
    flipped(found.directory / "pairs" / "pair-0000.nc")
    plenopiv.correlate(masked, out=tmp_path / "ended", **changed)
    assert len(measured) == 2
    names = ["velocity.nc", "pairs/pair-0000.nc", "pairs/pair-0001.nc"]
    assert all((found.directory / n).read_bytes() == (whole.directory / n).read_bytes() for n in names)


@pytest.mark.full
def test_pairs_stay_aside_for_their_frames_but_not_for_their_fields(recorded, tmp_path, monkeypatch, capsys):
    """The first frame is damaged, and the field of the last pair was bad with the run's windows."""
    names = ["a.tif", "b.tif", "c.tif", "d.tif"]
    experiment = sequence(recorded, tmp_path / "recording", names)
    first = experiment.folder / "a.tif"
    first.write_bytes(first.read_bytes()[:2000])
    with monkeypatch.context() as patch:
        patch.setattr(PairJudge, "of_field", lambda self, velocity, names: ([], "bad" if "d.tif" in names else None))
        run = plenopiv.process(experiment)
    assert [one["pair"] for one in run.summary["set_aside"]] == [0, 2]
    assert sorted(path.name for path in run.directory.glob("*.h5")) == [f"volume-{n}.h5" for n in "bcd"]
    assert main(["correlate", str(run.directory), "--windows", "40x40x24,32x32x20"]) == 3
    assert "1 of 3 pairs set aside:\n  a.tif and b.tif: " in capsys.readouterr().out
    made = run.directory.with_name("results-40x40x24-32x32x20")
    (aside,) = json.loads((made / "summary.json").read_text())["set_aside"]
    assert aside == run.summary["set_aside"][0]
    valid = open_series(made / "velocity.nc").valid.values
    assert [bool(one.any()) for one in valid] == [False, True, True]


@pytest.mark.full
@pytest.mark.parametrize("hot", [False, True])
def test_with_static_light_of_the_frames_only_hot_pixels_ask_for_these_again(tmp_path, monkeypatch, hot):
    """Ten thin pairs with a glow, and a pixel far brighter than any next to it or none."""
    folder = tmp_path / "recording"
    for k in range(10):
        made = record(tmp_path / "made", seed=k, overwrite=True, seeding=Seeding(particles_per_microlens=0.3)).directory
        shutil.copytree(made, folder, dirs_exist_ok=True)
        for pulse in "ab":
            image = tifffile.imread(made / f"{pulse}.tif")
            image[60:160, 80:240] += 90
            image[200, 200] += 900 if hot else 0
            tifffile.imwrite(folder / f"p{k}_{pulse}.tif", image)
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"].pop("frames")
    tables["recording"] |= {"pairs": "p*_{a,b}.tif", "background": "minimum"}
    tables["reconstruction"] = {"iterations": 1}
    tables["output"] = {"volumes": True}
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    run = plenopiv.process(Experiment.load(folder / "experiment.toml"))
    read, estimated = [], kept.with_static_light
    monkeypatch.setattr(kept, "with_static_light", lambda *given: read.append(given) or estimated(*given))
    again = plenopiv.correlate(run.directory, out=tmp_path / "again")
    assert len(read) == hot
    same_bits(again.velocity, run.velocity)
