"""``reconstruction.motion_tracking``: vectors of a run are those between frames that were reconstructed together."""

from dataclasses import replace

import pytest

import plenopiv
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.motion_tracking import reconstruct_together
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.frame import reconstructed
from plenopiv.run.plan import plan

pytestmark = pytest.mark.usefixtures("without_report")


@pytest.mark.full
def test_a_run(experiment):
    both = experiment.changed(motion_tracking=1)
    found = plenopiv.process(both)
    chain, recording, _ = calibrated_chain(both, both.recording())
    frames = [reconstructed(chain, recording, k, lambda *stage: None) for k in recording.pairs[0]]
    volumes = reconstruct_together(chain, [f.image for f in frames], [f.found.volume for f in frames])
    expected = chain.velocity(*volumes, recording.dt_s, recording.mid_time_s(0))
    velocity = read_velocity(found.directory / "velocity.nc")
    for name in ("u", "v", "w", "w_std"):
        assert velocity[name].values.tobytes() == expected[name].values.tobytes(), name
    assert Experiment.load(found.directory / "experiment.toml").reconstruction.motion_tracking == 1
    times = [plan(replace(chain, reconstruction=each.reconstruction.settings())).takes for each in (experiment, both)]
    assert times[1].frame == times[0].frame
    assert times[1].pair == pytest.approx(2 * times[0].pair + 2 * 0.6 * times[0].frame)


def test_volumes_of_pairs_are_not_kept(experiment):
    with pytest.raises(PlenoPIVError, match=r"output\.volumes: with reconstruction\.motion_tracking each pair has"):
        experiment.changed(motion_tracking=1, volumes=True)
