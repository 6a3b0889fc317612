"""Predicted times: against what runs took, what takes longer, and what is left."""

import json
import re
import sys
from pathlib import Path

import pytest

from plenopiv.displacement.settings import CorrelationSettings, Pass
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run.duration import FIRST_PAIR, TOLD, as_text, estimate, of_settings
from plenopiv.volume import VoxelGrid

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS / "accuracy"))
from conditions import CONDITIONS  # noqa: E402

# by run: voxels; seconds measured (times the machine's speed) and predicted of a frame, a pair, the run, on two cores
MEASURED = json.loads((BENCHMARKS / "speed" / "scaling.json").read_text())
PASSES = [Pass((32, 32, 16), 0.5)] * 2


def guess(experiment, **changes):
    settings = {"iterations": 5, "passes": PASSES, "threads": 2} | changes
    return estimate(experiment.camera(), experiment.grid(), **settings)


@pytest.mark.parametrize("name", MEASURED)
def test_what_is_predicted_is_what_runs_took(name):
    """Runs of docs/accuracy.md of 1.3 to 764 million voxels on the machine of docs/speed.md."""
    condition = CONDITIONS[name]
    grid = VoxelGrid.covering(*condition.volume_mm(), condition.voxel_mm())
    voxels, frame_s, _, pair_s, _, run_s, _ = MEASURED[name]
    assert grid.size == voxels
    camera, settings = condition.camera(), CorrelationSettings(windows=condition.windows)
    predicted = of_settings(camera, grid, ReconstructionSettings().through(camera), settings, threads=2)
    assert 1 / 1.5 < predicted.frame / frame_s < 1.5
    assert 1 / 1.3 < (predicted.pair + FIRST_PAIR) / pair_s < 1.3  # of the run's one pair
    assert 1 / 1.25 < predicted.run(2) / run_s < 1.25


def test_a_run_says_what_it_will_take(finished):
    """A small one: seconds of start and report, and little else, at the speed of docs/speed.md and with its kernels
    compiled; both are told where they are otherwise."""
    predicted = finished.summary["time_estimate_s"]
    told = re.search(
        r"time: about (.+?)(?:, (\d+) s of it to compile kernels, once on this machine)?"
        r"(?:; this machine has now (\d+) % of the speed of that in docs/speed.md)?$",
        finished.err,
        re.MULTILINE,
    )
    assert told[1] in {as_text(predicted + rounded) for rounded in (-0.06, 0.06)}
    otherwise = float(told[3]) / 100 if told[3] else 1.0
    nominal = (predicted - float(told[2] or 0)) * otherwise
    slack = 1.1 if told[3] else TOLD
    assert 5 / slack < nominal < 20 * slack


def test_what_takes_longer(experiment):
    usual = guess(experiment)
    assert usual.frame > guess(experiment, iterations=3).frame > guess(experiment, iterations=1).frame
    assert guess(experiment, every_voxel=True).frame > usual.frame
    none = guess(experiment, passes=[]).pair
    assert guess(experiment, passes=PASSES * 2).pair - none == pytest.approx(2 * (usual.pair - none))
    assert guess(experiment, passes=[Pass((32, 32, 16), 0.75)] * 2).pair > usual.pair
    windows, inner = (
        CorrelationSettings(((32, 32, 16),)),
        CorrelationSettings(((32, 32, 16),), inner_window=(20, 20, 10)),
    )
    assert guess(experiment, passes=inner.passes).pair > guess(experiment, passes=windows.passes).pair
    one = guess(experiment, threads=1)
    assert (one.frame, one.pair) == pytest.approx((2 * usual.frame, 2 * usual.pair))


def test_frames_and_pairs(experiment):
    usual = guess(experiment)
    assert usual.run(5) - usual.run(4) == pytest.approx(usual.frame + usual.pair)
    # twice as slow a first frame: all that follows is expected to be
    assert usual.left(3, 2 * usual.frame) == pytest.approx(4 * (usual.frame + usual.pair))


def test_spoken():
    assert [as_text(s) for s in (4.4, 89, 600, 9000)] == ["4 s", "89 s", "10 min", "2.5 h"]
