"""A sample of the steps at which the campaign ends a pretended series, and that it notices what is wrong."""

import pytest
import series_steps

SPOILING = """
import pretended_series

whole = pretended_series.session

def session(directory, *given, **named):
    if directory.exists():
        (directory / "left.txt").touch()
    return whole(directory, *given, **named)

pretended_series.session = session
"""


@pytest.mark.full
def test_what_a_run_leaves_behind_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(series_steps, "PROGRAM", SPOILING + series_steps.PROGRAM)
    found = series_steps.tried(tmp_path, 0, stride=150)
    assert any("other files: ['left.txt']" in one for one in found["why"])


@pytest.mark.full
@pytest.mark.parametrize("number", range(len(series_steps.WAYS)), ids=series_steps.WAYS)
def test_ended_at_a_sample_of_the_steps(tmp_path, number):
    found = series_steps.tried(tmp_path, number, stride=11)
    assert found["why"] is None
    assert found["steps"] > 30
