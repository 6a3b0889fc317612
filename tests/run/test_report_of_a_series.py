"""The report that a run of several pairs writes: its viewer has each time, mean and RMS."""

import re
import shutil

import pytest

import plenopiv
from plenopiv.errors import PlenoPIVError


@pytest.mark.usefixtures("without_report")
def test_a_pair_that_another_run_wrote_over_is_not_put_together(three_pairs, tmp_path):
    """While the last one was measured."""
    shutil.copytree(three_pairs, tmp_path / "recording")
    experiment = plenopiv.load(tmp_path / "recording" / "experiment.toml")
    pairs = tmp_path / "recording" / "results" / ".plenopiv" / "pairs"

    def watch(stage, done, total):
        if stage == "pairs" and done == total == 3:
            shutil.copy(pairs / "pair-0002.nc", pairs / "pair-0001.nc")

    with pytest.raises(PlenoPIVError, match=r"pair-0001\.nc: is damaged since its pair was measured"):
        plenopiv.process(experiment, progress=watch)
    assert plenopiv.process(experiment).velocity.sizes["time"] == 3


@pytest.mark.full
def test_the_report_of_a_run_has_its_times_mean_and_rms(three_pairs, tmp_path):
    shutil.copytree(three_pairs, tmp_path / "recording")
    result = plenopiv.process(plenopiv.load(tmp_path / "recording" / "experiment.toml"))
    page = (result.directory / "report.html").read_text()
    assert result.velocity.sizes["time"] == 3
    labels = re.findall(r'"label":"((?:pair|mean|RMS)[^"]*)"', page)
    assert labels == [
        *(f"pair {k + 1} of 3" for k in range(3)),  # of a double-frame camera: times only number them
        "mean of 3 pairs",
        "RMS fluctuation of 3 pairs",
    ]
