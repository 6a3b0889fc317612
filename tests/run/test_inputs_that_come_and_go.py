"""A recording that grows while it is measured, and one whose frames go."""

import os
import shutil
import tomllib

import pytest
import tomli_w
from conftest import record

import plenopiv
from plenopiv.cli import main
from plenopiv.experiment import Experiment
from plenopiv.io.manifest import Manifest
from plenopiv.run import pair

pytestmark = [pytest.mark.usefixtures("without_report"), pytest.mark.full]


@pytest.fixture
def recorded_pairs(tmp_path):
    """Three pairs in a folder, the last one aside; its experiment file takes all that are there."""
    folder = tmp_path / "recording"
    for k in (0, 1, 2):
        made = record(tmp_path / f"made-{k}", seed=k).directory
        folder.mkdir(exist_ok=True)
        (tmp_path / "aside").mkdir(exist_ok=True)
        for pulse in "ab":
            shutil.copy(made / f"{pulse}.tif", (tmp_path / "aside" if k == 2 else folder) / f"p{k}_{pulse}.tif")
    shutil.copy(made / "white.tif", folder)
    tables = Experiment.load(made / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["recording"].pop("frames")
    tables["recording"]["pairs"] = "p*_{a,b}.tif"
    tables["reconstruction"] = {"iterations": 2}
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return folder


def measured_by(monkeypatch):
    numbers, usual = [], pair.Job.pair

    def noted(self, number, *rest):
        numbers.append(number)
        return usual(self, number, *rest)

    monkeypatch.setattr(pair.Job, "pair", noted)
    return numbers


def test_pairs_that_were_added_are_measured_and_the_others_kept(recorded_pairs, tmp_path, monkeypatch):
    numbers, file = measured_by(monkeypatch), recorded_pairs / "experiment.toml"
    assert main(["run", str(file)]) == 0
    before = {path.name: path.read_bytes() for path in (recorded_pairs / "results" / "pairs").iterdir()}
    for path in (tmp_path / "aside").iterdir():
        shutil.move(path, recorded_pairs)
    assert main(["run", str(file)]) == 0
    assert numbers == [0, 1, 2]
    assert {name: (recorded_pairs / "results" / "pairs" / name).read_bytes() for name in before} == before
    assert set(Manifest.read(recorded_pairs / "results" / "manifest.jsonl").pairs) == {0, 1, 2}
    assert plenopiv.process(Experiment.load(file)).velocity.sizes["time"] == 3


def test_a_pair_that_was_alone_is_measured_as_one_of_several(recorded_pairs, tmp_path, monkeypatch):
    numbers, file = measured_by(monkeypatch), recorded_pairs / "experiment.toml"
    for name in ("p1_a.tif", "p1_b.tif"):
        shutil.move(recorded_pairs / name, tmp_path / "aside")
    assert main(["run", str(file)]) == 0
    for name in ("p1_a.tif", "p1_b.tif"):
        shutil.move(tmp_path / "aside" / name, recorded_pairs)
    assert main(["run", str(file)]) == 0
    assert numbers == [0, 0, 1]
    assert main(["run", str(file)]) == 0
    assert numbers == [0, 0, 1]


def test_frames_that_go_end_the_run_and_what_was_finished_is_kept(recorded_pairs, tmp_path, monkeypatch, capsys):
    numbers, file = measured_by(monkeypatch), recorded_pairs / "experiment.toml"
    usual = pair.Job.pair

    def and_gone(self, number, *rest):
        found = usual(self, number, *rest)
        os.replace(recorded_pairs / "p1_b.tif", tmp_path / "p1_b.tif")
        return found

    with monkeypatch.context() as patch:
        patch.setattr(pair.Job, "pair", and_gone)
        assert main(["run", str(file)]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert errors == [f"plenopiv: error: {recorded_pairs / 'p1_b.tif'}: is gone since the run began"]
    os.replace(tmp_path / "p1_b.tif", recorded_pairs / "p1_b.tif")
    assert main(["run", str(file)]) == 0
    assert numbers == [0, 1]


def test_a_list_of_pairs_may_grow(recorded_pairs, tmp_path, monkeypatch):
    numbers, file = measured_by(monkeypatch), recorded_pairs / "experiment.toml"
    for path in (tmp_path / "aside").iterdir():
        shutil.move(path, recorded_pairs)
    for pairs in (2, 3):
        tables = tomllib.loads(file.read_text())
        tables["recording"]["pairs"] = [[f"p{k}_a.tif", f"p{k}_b.tif"] for k in range(pairs)]
        file.write_text(tomli_w.dumps(tables))
        assert main(["run", str(file)]) == 0
    assert numbers == [0, 1, 2]


def test_a_frame_that_was_measured_and_is_another_one_now(recorded_pairs, tmp_path, monkeypatch, capsys):
    numbers, file = measured_by(monkeypatch), str(recorded_pairs / "experiment.toml")
    assert main(["run", file, "--pairs", "0-0"]) == 0
    for pulse in "ab":
        os.replace(tmp_path / "aside" / f"p2_{pulse}.tif", recorded_pairs / f"p0_{pulse}.tif")
    assert main(["run", file]) == 2
    assert "p0_a.tif is another image than the one that was measured" in capsys.readouterr().err
    assert main(["run", file, "--overwrite"]) == 0
    assert numbers == [0, 0, 1]


def test_the_last_of_array_jobs_may_ask_for_more_pairs_than_there_are(recorded_pairs, monkeypatch, capsys):
    numbers, file = measured_by(monkeypatch), str(recorded_pairs / "experiment.toml")
    assert main(["run", file, "--pairs", "1-4"]) == 0
    assert numbers == [1]
    assert "1 of 2 pairs are finished" in capsys.readouterr().out
    assert main(["run", file, "--pairs", "2-4"]) == 2
    assert "the recording has pairs 0 to 1" in capsys.readouterr().err


def test_a_job_that_sets_a_pair_aside_ends_with_3(recorded_pairs, capsys):
    frame = recorded_pairs / "p1_b.tif"
    frame.write_bytes(frame.read_bytes()[:2000])
    assert main(["run", str(recorded_pairs / "experiment.toml"), "--pairs", "1-1"]) == 3
    assert "1 of 1 pairs set aside:" in capsys.readouterr().out


def test_jobs_in_a_folder_that_is_complete_tell_of_their_pairs_alone(recorded_pairs, tmp_path, capsys):
    frame, file = recorded_pairs / "p1_b.tif", str(recorded_pairs / "experiment.toml")
    frame.write_bytes(frame.read_bytes()[:2000])
    assert main(["run", file]) == 3
    capsys.readouterr()
    assert main(["run", file, "--pairs", "0-0"]) == 0
    assert capsys.readouterr().out == "2 of 2 pairs are finished and put together\n"
    for path in (tmp_path / "aside").iterdir():
        shutil.move(path, recorded_pairs)
    assert main(["run", file, "--pairs", "0-0"]) == 0
    assert capsys.readouterr().out.startswith("2 of 3 pairs are finished; plenopiv run ")
