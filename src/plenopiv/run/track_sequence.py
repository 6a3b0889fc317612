"""The frames of a sequence, one after the other: the first ones reconstructed, later ones from predictions.

Particles of the first frames are found and linked as in pairs. From then on a frame begins where the tracks predict its
particles, and neither reconstruction nor correlation is made. Where the prediction fails, the frame is begun anew. What
a frame needs of earlier ones, positions, tracks and noise, is in their files.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.particles_file import read_particles, write_particles
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run.frame import LostFrame, Progress, taken_or_lost
from plenopiv.run.judged import Judged, PairJudge
from plenopiv.run.log import Clock
from plenopiv.run.pair import PairRecord
from plenopiv.run.track_frame import FrameTracker, ImageOfFrame, PredictedFrame, TrackedFrame, own
from plenopiv.run.track_pair import linked, median_std
from plenopiv.tracking.follow import FEWEST, followed
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.predict import FRAMES, LOST, SHORT, predicted
from plenopiv.tracking.sightings import SeenFrame
from plenopiv.volume import SparseVolume

METHOD = "multi-frame"
BEGUN = 4  # frames that are reconstructed before others are predicted

Int = NDArray[np.int64]


@dataclass(frozen=True)
class KeptFrame:
    """What is kept of a frame: its particles and their tracks; ``dark``: standard deviation of a dark pixel in counts;
    ``unused``: the least number that no track of it or an earlier frame has."""

    seen: SeenFrame
    dark: float
    unused: int


def check_sequence(recording: Recording) -> None:
    """Raise PlenoPIVError for a recording whose frames are not a sequence, equally spaced in time."""
    if not recording.is_sequence:
        raise PlenoPIVError(
            f'tracking.method: "{METHOD}" takes a sequence of frames, each recording.dt_s after the one before; these '
            'are pairs of pulses: use "two-frame"'
        )
    if len(recording) < BEGUN:
        raise PlenoPIVError(
            f'tracking.method: "{METHOD}" takes {BEGUN} frames or more, there are {len(recording)}: use "two-frame"'
        )


@dataclass
class SequenceJob:
    """Tracks the frames of a sequence into the ``folder`` of its results, and judges its pairs."""

    tracker: FrameTracker
    table: TrackingTable
    judge: PairJudge
    folder: SeriesFolder
    clock: Clock
    report: Progress
    past: list[KeptFrame] = field(default_factory=list)  # the last frames
    unused: int = 0  # the least number that no track has
    volume: tuple[int, SparseVolume] | None = None  # the last frame's number and volume, if it was reconstructed
    shown: dict[int, Judged] = field(default_factory=dict)  # the last frames, by number, as they are judged

    @property
    def left(self) -> list[int]:
        """The pairs that are still to be made: the first that is missing, or was made after other frames than there are
        now, as where a run that made earlier ones anew was ended; and all after it."""
        count, finished = len(self.tracker.recording.pairs), self.folder.finished
        for number in range(count):
            if number not in finished:
                return list(range(number, count))
            after = last_kept(self.folder, number)
            if number and finished[number]["numbers"].get("after", after) != after:
                return list(range(number, count))
        return []

    def records(self, numbers: Sequence[int]) -> Iterator[PairRecord]:
        """The records of the pairs ``numbers``, each the one after the other, the frames' files written.

        Raises:
            PlenoPIVError: a file cannot be written, or the file of a frame is gone since the run began.
        """
        if not numbers:
            return
        before: LostFrame | dict[str, Any]
        said = list[str]()  # of the first frame
        if numbers[0] == 0:
            before, files, said, _ = self._frame(0, PairRecord(0, []))
        else:
            self._look_back(numbers[0])
            before, files = self.folder.finished[numbers[0] - 1]["frames"][1], []
            if not self.past or self.past[-1].seen.number < numbers[0]:
                before = self._frame(numbers[0], PairRecord(0, []))[0]  # it was lost, and says why once more
        for number in numbers:
            record = PairRecord(number, [before.entry if isinstance(before, LostFrame) else before])
            record.numbers["after"] = last_kept(self.folder, number) if number else None
            after, more, told, count = self._frame(number + 1, record)
            record.frames.append(after.entry if isinstance(after, LostFrame) else after)
            record.files, record.warnings = [*files, *more], [*said, *told]
            for one in (before, after):
                if isinstance(one, LostFrame):
                    record.set_aside = one.reason
            if record.set_aside is None:
                found, record.set_aside = self.judge.of_images(self.shown[number], self.shown[number + 1])
                record.findings += map(asdict, found)
            if record.set_aside is None:
                record.numbers |= self._numbers(number, count)
            yield record
            before, files, said = after, [], []

    def _look_back(self, number: int) -> None:
        """Read the frames before ``number`` and itself, as far as the next one needs them."""
        kept = frames_kept(self.folder, range(max(number - FRAMES, 0), number + 1))
        self.past += [read_frame(path, k) for k, path in kept.items()]
        if (last := last_kept(self.folder, number)) is not None:
            self.unused = read_frame(self.folder.there(last[0]), number).unused
        if number in kept:
            recording = self.tracker.recording
            self.shown[number] = ImageOfFrame(recording.frames[number].name, recording.light(number)[0])

    def _frame(self, number: int, record: PairRecord) -> tuple[LostFrame | dict[str, Any], list[str], list[str], int]:
        """Frame ``number``: why it was lost, or its entry in the manifest; files, what was warned of, and how many of
        its particles go on with a track of the frame before."""
        with self.clock("particles"):
            follows, said = self._followed(number, record)
        found: PredictedFrame | TrackedFrame
        if follows is not None:
            found, tracks = follows
            self.volume, dark = None, self.past[-1].dark
        else:
            with self.clock("particles"):
                take = partial(self.tracker.frame, number, self.report)
                taken = taken_or_lost(self.tracker.recording, number, take)
            if isinstance(taken, LostFrame):
                self.volume = None
                return taken, [], list(taken.warned), 0
            found, tracks = taken, self._linked(taken, record)
            self.volume, dark = (number, taken.volume), taken.dark
        self.unused = max(int(tracks.max(initial=-1)) + 1, self.unused)
        kept = KeptFrame(SeenFrame(number, found.particles, tracks), dark, self.unused)
        before = next((one.seen.track for one in self.past if one.seen.number == number - 1), np.empty(0))
        self.past = [*self.past[1 - FRAMES :], kept]
        self.shown = {k: each for k, each in self.shown.items() if k == number - 1} | {number: found.shown}
        name = frame_file(number)
        write_frame(self.folder.path(name), kept)
        goes_on = np.isin(tracks, before) & own(found.particles.position_mm, self.tracker.chain.grid)
        return found.entry, [name], [*said, *found.warned], int(goes_on.sum())

    def _followed(self, number: int, record: PairRecord) -> tuple[tuple[PredictedFrame, Int] | None, list[str]]:
        """Frame ``number`` from predictions and the tracks of its particles, None where it has to be reconstructed, and
        what is to be said."""
        seen = [one.seen for one in self.past if one.seen.number >= number - FRAMES]
        if len(seen) < BEGUN or seen[-1].number < number - 1 - LOST or not _goes_back(seen):
            return None, []
        name = self.tracker.recording.frames[number].name
        limits = self.tracker.limits(self.tracker.chain.grid)
        by = predicted(seen, number, limits, self.tracker.of_points.prior_std_mm)
        there, follows = 0, None
        with suppress(PlenoPIVError):  # reconstruction says what is wrong with the frame
            found = self.tracker.predicted(number, by, self.past[-1].dark, self.report)
            follows = followed(found.particles, found.origin, by, self.unused)
            there = follows.kept
        if follows is None or there < FEWEST * by.active.sum():
            said = (
                f"{name}: {there} of {int(by.active.sum())} particles are where the frames before let expect "
                "them; it is reconstructed, and tracked anew"
            )
            return None, [said]
        record.numbers["left_by_prediction_mm"] = follows.off_mm.tolist()
        return (found, follows.track), []

    def _linked(self, taken: TrackedFrame, record: PairRecord) -> Int:
        """The tracks of a reconstructed frame's particles: those that correlation links to the frame before."""
        tracks = self.unused + np.arange(len(taken.particles.light))
        before = self.past[-1].seen if self.past and self.past[-1].seen.number == taken.number - 1 else None
        if before is None:
            return tracks
        chain = self.tracker.chain
        with self.clock("links and field"), record.measuring(only=False):
            if self.volume is not None and self.volume[0] == before.number:
                volume = self.volume[1]
            else:
                volume = self.tracker.volume(before.number, self.report)
            moved = chain.displacement(volume, taken.volume, self.report)
            links = linked(before.particles, taken.particles, moved, chain.grid, self.table)
            tracks[links.b] = before.track[links.a]
            record.numbers["left_by_correlation_mm"] = links.scatter_mm.tolist()
        return tracks

    def _numbers(self, number: int, linked: int) -> dict[str, Any]:
        """What the record of a pair says of its frames."""
        first, second = (one.seen.particles for one in self.past[-2:])
        here, there = (own(each.position_mm, self.tracker.chain.grid) for each in (first, second))
        numbers = {"particles": [int(here.sum()), int(there.sum())], "linked": linked}
        return numbers | median_std(second.covariance[there])


def _goes_back(seen: Sequence[SeenFrame]) -> bool:
    """Whether tracks of the last frame ``seen`` tell velocities: those that were begun anew, after lost frames or a
    cut, do not yet, and earlier ones have ended."""
    tracks, times = np.unique(np.concatenate([one.track for one in seen]), return_counts=True)
    last = np.isin(tracks, seen[-1].track)
    return bool(np.sum(times[last] >= SHORT - 1) >= max(FEWEST * last.sum(), 1))


def frame_file(number: int) -> str:
    """Name of the file of a frame's particles, from 0, in the folder of the tracking."""
    return f"pairs/particles-{number:04d}.npz"


def last_kept(folder: SeriesFolder, number: int) -> list[str] | None:
    """File and hash of the last frame up to ``number`` whose particles are kept; None where none is. Pairs from there
    on follow from it."""
    for k in range(number, -1, -1):
        record = folder.finished.get(max(k - 1, 0))  # of the pair that it came with
        if record is not None and (name := frame_file(k)) in record["files"]:
            return [name, record["files"][name]]
    return None


def frames_kept(folder: SeriesFolder, numbers: Sequence[int]) -> dict[int, Path]:
    """The files of those of the frames ``numbers`` that finished pairs have; others that lie there are of results that
    are being replaced."""
    listed = {name for record in folder.finished.values() for name in record["files"]}
    return {k: folder.there(frame_file(k)) for k in numbers if frame_file(k) in listed}


def write_frame(path: Path, frame: KeptFrame) -> None:
    """Write a frame's particles and tracks.

    Raises:
        PlenoPIVError: as ``write_particles``.
    """
    particles = {one.name: getattr(frame.seen.particles, one.name) for one in fields(FrameParticles)}
    write_particles(path, particles | {"track": frame.seen.track, "dark": frame.dark, "unused": frame.unused})


def read_frame(path: Path, number: int) -> KeptFrame:
    """What ``write_frame`` wrote of frame ``number``.

    Raises:
        PlenoPIVError: the file is damaged.
    """
    values: dict[str, Any] = read_particles(path)
    track, dark, unused, chi2 = (values.pop(name) for name in ("track", "dark", "unused", "chi2"))
    particles = FrameParticles(chi2=float(chi2), **values)
    return KeptFrame(SeenFrame(number, particles, track), float(dark), int(unused))
