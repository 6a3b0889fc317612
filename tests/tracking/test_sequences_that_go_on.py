"""A sequence whose tracking is ended and goes on has the tracks of one that was never ended. Frames are pretended."""

from types import SimpleNamespace

import numpy as np
import pytest

import plenopiv.run.track_sequence as track_sequence
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.run.frame import LostFrame
from plenopiv.run.log import Clock
from plenopiv.run.track_sequence import SequenceJob, frames_kept, read_frame
from plenopiv.tracking.frame import FrameParticles
from plenopiv.volume import VoxelGrid

PARTICLES, LINKED = 6, 4
STATED = {"settings": {}, "files": {}, "versions": {}}
GRID = VoxelGrid.covering((-2, 2), (-2, 2), (-2, 2), (0.1, 0.1, 0.1))


class Ended(Exception):
    """A run is ended here."""


def particles():
    position = np.random.default_rng(1).uniform(-1, 1, (PARTICLES, 3))
    one, alike = np.ones(PARTICLES), np.tile(np.eye(4), (PARTICLES, 1, 1))
    said = 1e6 * alike[:, :3, :3], np.zeros((PARTICLES, 3))
    return FrameParticles(position, one, 1e-6 * alike, one, 1.0, *said)


class Sequence(SequenceJob):
    """Each frame is reconstructed; some of its particles go on with the tracks of the frame before."""

    def _followed(self, number, record):
        return None, []

    def _linked(self, taken, record):
        tracks = self.unused + np.arange(PARTICLES)
        if self.past and self.past[-1].seen.number == taken.number - 1:
            tracks[:LINKED] = self.past[-1].seen.track[:LINKED]
        return tracks


def tracked(directory, monkeypatch, frames, lost=(), forgotten=(), last=None):
    """The tracks of all frames after a run that is ended after pair ``last``; which pairs it made."""

    def taken(recording, number, take):
        name = recording.frames[number].name
        if number in lost:
            return LostFrame(number, SimpleNamespace(name=name, path=name), "dark", {"name": name})
        shown = SimpleNamespace(name=name, image=None, unexplained=None)
        return SimpleNamespace(
            particles=particles(), volume=None, dark=1.0, entry={"name": name}, warned=(), shown=shown, number=number
        )

    monkeypatch.setattr(track_sequence, "taken_or_lost", taken)
    recording = SimpleNamespace(
        pairs=[(k, k + 1) for k in range(frames - 1)],
        frames=[SimpleNamespace(name=f"f{k}") for k in range(frames)],
        light=lambda number: (np.zeros((2, 2)), None),
    )
    tracker = SimpleNamespace(recording=recording, frame=list, chain=SimpleNamespace(grid=GRID))
    judge = SimpleNamespace(of_images=lambda first, second: ([], None))
    with SeriesFolder(directory) as folder:
        folder.begin(STATED)
        folder.settle(STATED | {"calibration": {}})
        for number in forgotten:  # as where a frame is another one now
            del folder.finished[number]
        job = Sequence(tracker, None, judge, folder, Clock(), None)
        left = job.left
        for record in job.records(left):
            folder.store(record.content(), record.files)
            if record.pair == last:
                raise Ended
        kept = frames_kept(folder, range(frames))
        tracks = {k: read_frame(path, k).seen.track.tolist() for k, path in kept.items()}
        folder.write_text("summary.json", "{}")
        folder.publish(["summary.json"], STATED | {"calibration": {}})
        return tracks, left


def test_tracks_are_linked(tmp_path, monkeypatch):
    tracks, left = tracked(tmp_path / "a", monkeypatch, 4)
    assert left == [0, 1, 2]
    assert tracks == {0: [0, 1, 2, 3, 4, 5], 1: [0, 1, 2, 3, 10, 11], 2: [0, 1, 2, 3, 16, 17], 3: [0, 1, 2, 3, 22, 23]}


@pytest.mark.parametrize("last", [1, 4, 10])
def test_a_run_that_was_ended_goes_on_with_new_numbers(tmp_path, monkeypatch, last):
    """Nine frames are lost, more than are looked back at."""
    lost = range(3, 12)
    whole, _ = tracked(tmp_path / "a", monkeypatch, 14, lost)
    with pytest.raises(Ended):
        tracked(tmp_path / "b", monkeypatch, 14, lost, last=last)
    tracks, left = tracked(tmp_path / "b", monkeypatch, 14, lost)
    assert left == list(range(last + 1, 13))
    assert tracks == whole
    assert min(tracks[12]) > max(tracks[2])


def test_a_lost_frame_is_not_said_to_be_tracked_anew(tmp_path, monkeypatch):
    """That it is not where it was predicted is said of a frame that is reconstructed instead."""
    monkeypatch.setattr(Sequence, "_followed", lambda self, number, record: (None, [f"{number} is tracked anew"]))
    said, store = [], SeriesFolder.store

    def stored(folder, content, files):
        said.extend(content["warnings"])
        return store(folder, content, files)

    monkeypatch.setattr(SeriesFolder, "store", stored)
    tracked(tmp_path / "a", monkeypatch, 4, lost={2})
    assert "1 is tracked anew" in said
    assert not any(line.startswith("2 is") for line in said)


def test_pairs_that_were_made_after_other_frames_are_made_again(tmp_path, monkeypatch):
    """A lost frame is there again, and the run that makes the pairs from there on anew is ended."""
    at = tmp_path / "a"
    tracked(at, monkeypatch, 12, lost={5})
    with pytest.raises(Ended):
        tracked(at, monkeypatch, 12, forgotten=[4, 5], last=6)
    tracks, left = tracked(at, monkeypatch, 12)
    assert left == [7, 8, 9, 10]
    assert tracks == tracked(tmp_path / "b", monkeypatch, 12)[0]
    assert tracked(at, monkeypatch, 12)[1] == []
