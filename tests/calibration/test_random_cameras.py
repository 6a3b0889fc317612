"""A sample of the white images of random cameras, and what was recorded of all."""

import json
import sys
from pathlib import Path

import pytest
from pages_of_benchmarks import as_written

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "calibration"))

from white_page import PAGE, page
from white_scores import RESULTS, RIGHT_PX, scored, summary


@pytest.fixture(scope="module")
def recorded():
    return json.loads(RESULTS.read_text())


def test_recorded_cameras(recorded):
    """Right in 95 of 100 answered, wrong in silence in one at most, 8 refused at most."""
    s = summary(list(recorded.values()))
    assert s["cameras"] >= 200
    assert s["right"] >= 0.95 * s["answered"]
    assert s["wrong in silence"] <= max(1, 0.01 * s["cameras"])
    assert s["refused"] <= 0.08 * s["cameras"]
    assert s["crashed"] == 0


def test_the_page_is_what_was_recorded(recorded):
    assert as_written(PAGE) == page(recorded)


@pytest.mark.full
@pytest.mark.parametrize("number", [5, 16, 31])
def test_a_camera_again(number, recorded):
    """Ramps of light within the discs; spots of 1.4 px; a cat's eye of 2.6 px of 4.1."""
    found = scored(number)
    assert found["worst_px"] < RIGHT_PX
    assert found["worst_px"] == pytest.approx(recorded[str(number)]["worst_px"], abs=0.05)
