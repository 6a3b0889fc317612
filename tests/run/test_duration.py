"""Predicted times."""

import pytest

from plenopiv.displacement.settings import CorrelationSettings, Pass
from plenopiv.run.duration import as_text, estimate

PASSES = [Pass((32, 32, 16), 0.5)] * 2


def guess(experiment, **changes):
    settings = {"iterations": 5, "passes": PASSES, "threads": 2} | changes
    return estimate(experiment.camera(), experiment.grid(), **settings)


def test_what_takes_longer(experiment):
    usual = guess(experiment)
    assert usual.frame > guess(experiment, iterations=3).frame > guess(experiment, iterations=1).frame
    assert guess(experiment, every_voxel=True).frame > usual.frame
    assert guess(experiment, passes=PASSES * 2).pair == pytest.approx(2 * usual.pair)
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
