"""The files of a sequence's frames: which of those that lie there a run goes on with."""

from types import SimpleNamespace

import numpy as np

from plenopiv.io.series_folder import SeriesFolder
from plenopiv.run.frame import LostFrame
from plenopiv.run.log import Clock
from plenopiv.run.track_sequence import KeptFrame, SequenceJob, frame_file, frames_kept, read_frame, write_frame
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.sightings import SeenFrame


def particles(n):
    """Some particles of a frame."""
    position = np.random.default_rng(1).uniform(-1.0, 1.0, (n, 3))
    known = np.tile(1e6 * np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    return FrameParticles(position, np.full(n, 100.0), np.tile(1e-6 * np.eye(4), (n, 1, 1)), np.ones(n), 1.0, *known)


def tracked(directory, threshold, n, lost=()):
    """Particles used of each of four frames, after a run that finds n in all but the ``lost`` ones."""
    stated = {"settings": {"threshold": threshold}, "files": {}, "versions": {}}
    with SeriesFolder(directory, overwrite=True) as folder:
        folder.begin(stated)
        inputs = {**stated, "calibration": {}}
        folder.settle(inputs)
        for k in set(range(4)).difference(lost):
            write_frame(folder.path(frame_file(k)), KeptFrame(SeenFrame(k, particles(n), np.arange(n)), 1.0, n))
        for pair in range(3):
            files = [frame_file(k) for k in ((0, 1) if pair == 0 else (pair + 1,)) if k not in lost]
            aside = "lost" if {pair, pair + 1} & set(lost) else None
            record = {"pair": pair, "frames": [], "set_aside": aside, "findings": [], "summaries": {}}
            folder.store(record, files)
        used = {k: len(read_frame(path, k).seen.track) for k, path in frames_kept(folder, range(4)).items()}
        folder.write_text("summary.json", "{}")
        folder.publish(["summary.json"], inputs)
    return used


def test_frames_of_results_that_are_replaced_are_not_used(tmp_path):
    assert tracked(tmp_path, 10, 50) == dict.fromkeys(range(4), 50)
    assert tracked(tmp_path, 40, 30, lost=[2]) == {0: 30, 1: 30, 3: 30}


class AllLost(SequenceJob):
    """Of which every frame is lost, and says so."""

    def _frame(self, number, record):
        return LostFrame(number, None, "dark", {}), [], [f"frame {number} is dark"], 0


def test_what_is_warned_of_in_the_first_frame_is_told_with_its_pair():
    made = AllLost(None, None, None, SimpleNamespace(finished={}), Clock(), None).records([0, 1])
    assert [one.warnings for one in made] == [["frame 0 is dark", "frame 1 is dark"], ["frame 2 is dark"]]
