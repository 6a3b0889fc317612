"""The report that a run of several pairs writes: its viewer has each time, mean and RMS."""

import re
import shutil

import pytest

import plenopiv


@pytest.mark.full
def test_the_report_of_a_run_has_its_times_mean_and_rms(three_pairs, tmp_path):
    shutil.copytree(three_pairs, tmp_path / "recording")
    result = plenopiv.process(plenopiv.load(tmp_path / "recording" / "experiment.toml"))
    page = (result.directory / "report.html").read_text()
    times = result.velocity.time.values
    labels = re.findall(r'"label":"((?:pair|mean|RMS)[^"]*)"', page)
    assert labels == [
        *(f"pair {k + 1} of 3, t = {time:.6g} s" for k, time in enumerate(times)),
        "mean of 3 pairs",
        "RMS fluctuation of 3 pairs",
    ]
