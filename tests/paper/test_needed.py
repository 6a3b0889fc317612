"""What tracks and finer windows tell of a window's mean, against flows of which they must tell all."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import needed
from comparison_settings import REDUCED, TINY

from plenopiv.simulation.flows import flow

pytestmark = pytest.mark.full

SETTING = TINY.light_field


def test_windows_lie_where_they_are_judged():
    at, half = needed.centres(REDUCED.light_field), needed.half_window(REDUCED.light_field)
    low, high = at.min(0) - half, at.max(0) + half
    np.testing.assert_allclose(half, [0.549, 0.549, 0.615], atol=1e-3)
    for axis, limits in enumerate((*REDUCED.light_field.judged_mm, (-10.0, 10.0))):
        assert limits[0] <= low[axis] + 1e-9 < limits[0] + half[axis]
        assert limits[1] - half[axis] < high[axis] - 1e-9 <= limits[1]


def test_tracks_of_a_shear_tell_all_but_the_mean_of_those_in_the_window():
    sheared = flow("shear", rate_per_s=20.0)
    told = needed.tracks(SETTING, sheared, 1.0)
    assert max(told["linear_fit"]) < 1e-3
    assert max(told["smooth_field"]) < 1e-3
    assert told["mean"][0] > 0.02


def test_more_tracks_tell_more_of_the_jet():
    few, many = (needed.tracks(SETTING, flow("jet", at_mm=TINY.jet_at_mm), density) for density in (0.5, 4.0))
    assert many["particles_per_window"] == pytest.approx(8 * few["particles_per_window"], rel=0.3)
    for name in ("mean", "linear_fit", "smooth_field"):
        assert np.all(np.array(many[name]) < few[name])


def test_all_three_are_written(tmp_path):
    needed.main(tmp_path, reduced=True)
    found = json.loads((tmp_path / "paper/results/needed.json").read_text())
    assert [len(found[name]) for name in ("tracks", "windows", "beyond")] == [1, 2, 2]
    exact, light_field = found["windows"]
    assert (exact["volumes"], light_field["volumes"]) == ("exact", "light_field")
    for line in found["windows"]:
        assert 0 < line["bands"]["all"]["rms_voxel"][0] < 2
    for line, inner in zip(found["beyond"], (None, list(SETTING.inner_window)), strict=True):
        assert line["z_mm"] == list(SETTING.volume_mm[2])
        assert line["inner_window"] == inner
