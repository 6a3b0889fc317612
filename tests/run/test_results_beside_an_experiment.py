"""Results hold an experiment.toml: the user's own, in the folder where they are to be, is not replaced."""

import pytest

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.series_folder import EXPERIMENT, SeriesFolder

NOTES = "# laser at 40 mJ, run of Tuesday\n"
INPUTS = {"settings": {"overlap": 0.5}}


def session(directory, setting=0.5, overwrite=False, publish=True):
    """A run of a pretended pair."""
    inputs = {"settings": {"overlap": setting}}
    with SeriesFolder(directory, overwrite) as folder:
        folder.begin(inputs)
        now = inputs | {"calibration": {}}
        folder.settle(now)
        for name in ("velocity.nc", EXPERIMENT, "summary.json"):
            folder.write_text(name, f"{setting}\n")
        folder.store({"pair": 0, "set_aside": None}, ["velocity.nc"])
        if publish:
            folder.publish([EXPERIMENT, "summary.json"], now)


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_that_no_run_wrote_is_refused(tmp_path, overwrite):
    (tmp_path / EXPERIMENT).write_text(NOTES)
    with pytest.raises(PlenoPIVError, match=r"experiment\.toml: no run wrote it.*give output\.directory a folder"):
        session(tmp_path, overwrite=overwrite)
    assert [path.name for path in tmp_path.iterdir()] == [EXPERIMENT]
    assert (tmp_path / EXPERIMENT).read_text() == NOTES


def test_the_file_of_results_is_replaced_with_them(tmp_path):
    session(tmp_path)
    session(tmp_path, setting=0.75, overwrite=True)
    assert (tmp_path / EXPERIMENT).read_text() == "0.75\n"
    (tmp_path / "manifest.jsonl").unlink()  # as earlier programs left results
    session(tmp_path, overwrite=True)
    assert (tmp_path / EXPERIMENT).read_text() == "0.5\n"


def test_an_unfinished_run_beside_other_files_goes_on(tmp_path):
    (tmp_path / "notes.txt").write_text(NOTES)
    session(tmp_path, publish=False)
    session(tmp_path)
    assert (tmp_path / EXPERIMENT).read_text() == "0.5\n"


@pytest.mark.parametrize("directory", [".", "../recording", "./results/.."])
def test_a_run_into_the_folder_of_its_experiment_is_one_line(experiment, directory, capsys):
    file = experiment.path
    (experiment.folder / "results").mkdir()
    text = NOTES + experiment.changed(directory=directory).dump_toml()
    file.write_text(text)
    before = sorted(experiment.folder.iterdir())
    assert main(["run", str(file), "--overwrite"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if "error" in line] == said[-1:]
    assert "no run wrote it, and results would replace it" in said[-1]
    assert file.read_text() == text
    assert sorted(experiment.folder.iterdir()) == before
    assert Experiment.load(file).recording()  # other commands take it
