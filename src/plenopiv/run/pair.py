"""A pair of frames correlated, judged and written: what a series repeats.

Kept volumes are written as their frames are reconstructed. Both pairs that a frame of a sequence belongs to have its
file in their records, since either may be the only one that is measured.

A ``Job`` is plain data that pickles, so that its frames and pairs can be measured anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.chain import Chain
from plenopiv.displacement.resolution import effective_window
from plenopiv.errors import PlenoPIVError
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import pair_file
from plenopiv.io.volumes import Laboratory, write_volume
from plenopiv.motion_tracking import reconstruct_together
from plenopiv.recording import Recording
from plenopiv.run.frame import Frame, LostFrame, Progress, caught_warnings, reconstructed, taken_or_lost
from plenopiv.run.inputs import frame_entry
from plenopiv.run.judged import PairJudge
from plenopiv.statistics import velocity_gradients
from plenopiv.velocity import replaced, vectors_inside_body
from plenopiv.volume import SparseVolume

if TYPE_CHECKING:
    import xarray


@dataclass
class PairRecord:
    """What is kept of a pair beside its field: the frames' entries in the manifest, why it was ``set_aside`` if it was,
    findings that are not good, warnings of the frames and of the field, summaries of the frames, and numbers of the
    field. ``files``: names in the results folder of what was written. ``again``: it was set aside for no fault of its
    frames, and the next run tries once more."""

    pair: int
    frames: list[dict[str, Any]]
    set_aside: str | None = None
    findings: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    field_warnings: list[str] = field(default_factory=list)
    summaries: dict[str, dict[str, Any]] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    again: bool = False

    @contextmanager
    def measuring(self, only: bool) -> Iterator[None]:
        """Keep what is warned of in this block as warnings of the field; an error sets the pair aside.

        Raises:
            PlenoPIVError: the same error, where the pair is the ``only`` one.
        """
        with caught_warnings() as said:
            try:
                yield
            except PlenoPIVError as error:
                if only:
                    raise
                self.set_aside = str(error)
        self.field_warnings += said

    def content(self) -> dict[str, Any]:
        """As the manifest has it, without the files."""
        return {key: value for key, value in asdict(self).items() if key != "files"}


@dataclass(frozen=True)
class Job:
    """What measures every pair of a recording and writes it below ``folder``: with ``volumes`` those of the frames
    too, with ``gradients`` the derivatives of each field. ``source``: what the fields say that they come from.
    ``while_there``: on a worker, the file without which the run has ended, and nothing is written."""

    chain: Chain
    recording: Recording
    judge: PairJudge
    folder: Path
    source: str
    volumes: bool = False
    gradients: bool = False
    while_there: Path | None = None

    def follows(self, number: int) -> bool:
        """Whether a pair's second frame needs its first: none does."""
        return False

    def frame(self, number: int, progress: Progress) -> Frame | LostFrame:
        """Frame ``number`` (from 0), reconstructed, and its volume written where volumes are kept.

        Raises:
            PlenoPIVError: that cannot be written; or the frame's file is gone since the run began: others will be too,
                and the cause can be removed.
        """
        found = taken_or_lost(
            self.recording, number, partial(reconstructed, self.chain, self.recording, number, progress)
        )
        if self.volumes and isinstance(found, Frame):
            path, space = self._path(volume_file(self.recording, number)), self.chain.space
            laboratory = None if space is None else Laboratory(space.to_laboratory, self.chain.grid)
            write_volume(path, found.found.volume, laboratory)
        return found

    def not_asked(self, number: int) -> LostFrame:
        """Frame ``number``, which need not be reconstructed because the other one of its pair is lost."""
        source = self.recording.frames[number]
        return LostFrame(number, source, "", frame_entry(source))

    def given_up(self, number: int, reason: str) -> PairRecord:
        """The record of a pair that is set aside for a ``reason`` that lies not in its frames."""
        return given_up(self.recording, number, reason)

    def pair(self, number: int, before: Frame | LostFrame, after: Frame | LostFrame, progress: Progress) -> PairRecord:
        """Measure a pair between its frames and write its field.

        Raises:
            PlenoPIVError: a file cannot be written.
        """
        if isinstance(before, LostFrame):
            after = self.not_asked(after.number)  # as where it was not made
        record = PairRecord(number, [before.entry, after.entry], warnings=[*before.warned, *after.warned])
        if isinstance(before, LostFrame) or isinstance(after, LostFrame):
            record.set_aside = next(one.reason for one in (before, after) if isinstance(one, LostFrame) and one.reason)
            return record
        if self.volumes:
            record.files += [volume_file(self.recording, frame.number) for frame in (before, after)]
        found, record.set_aside = self.judge.of_images(before, after)
        record.findings += map(asdict, found)
        if record.set_aside is not None:
            return record
        record.summaries = {self.recording.names[frame.number]: frame.summary() for frame in (before, after)}
        if self.chain.reconstruction.motion_tracking:
            return self._measured(record, partial(self._together, before, after, progress), progress)
        return self.measured(record, before.found.volume, after.found.volume, progress)

    def _together(self, before: Frame, after: Frame, progress: Progress) -> tuple[SparseVolume, SparseVolume]:
        """The volumes of two frames that are reconstructed again from what they share."""
        frames = before, after
        return reconstruct_together(
            self.chain,
            [frame.image for frame in frames],
            [frame.found.volume for frame in frames],
            [frame.name for frame in frames],
            [frame.static for frame in frames],
            progress,
        )

    def measured(self, record: PairRecord, a: SparseVolume, b: SparseVolume, progress: Progress) -> PairRecord:
        """Measure the field between the volumes of a pair's frames, judge and write it, and complete its record.

        Raises:
            PlenoPIVError: a file cannot be written; nothing is found in the only pair.
        """
        return self._measured(record, lambda: (a, b), progress)

    def _measured(
        self, record: PairRecord, volumes: Callable[[], tuple[SparseVolume, SparseVolume]], progress: Progress
    ) -> PairRecord:
        """``measured`` of volumes that are made when they are asked for."""
        time_s, names = self.recording.mid_time_s(record.pair), (record.frames[0]["name"], record.frames[1]["name"])

        def measure() -> xarray.Dataset:
            field = self.chain.velocity(*volumes(), self.recording.dt_s, time_s, progress)
            field["time"].attrs["long_name"] = self.recording.time_meaning
            return field

        return self.completed(record, measure, names)

    def completed(
        self,
        record: PairRecord,
        measure: Callable[[], xarray.Dataset],
        names: tuple[str, str],
        count: int | None = None,
    ) -> PairRecord:
        """Take the field that ``measure`` gives between the frames ``names``, judge and write it, and complete its
        record. ``count``: how many fields there are, where it is not that of pairs.

        Raises:
            PlenoPIVError: a file cannot be written; nothing is found in the only field.
        """
        only = (count or len(self.recording.pairs)) == 1
        with record.measuring(only):
            velocity = measure()
        if record.set_aside is not None:
            return record
        found, record.set_aside = self.judge.of_field(velocity, names)
        record.findings += map(asdict, found)
        if record.set_aside is not None:
            return record
        record.numbers = numbers_of(velocity, self.chain.grid.voxel_mm, self.recording.dt_s)
        if self.gradients:
            derived = velocity_gradients(velocity.isel(time=0), self.chain.correlation)
            velocity = velocity.assign(derived.expand_dims("time"))  # its own time, which keeps unit and meaning
        resolved = list(effective_window(self.chain.correlation))
        velocity.attrs |= {"source": self.source, "quality": self.judge.quality(record.findings)}
        velocity.attrs["effective_window_voxels"] = resolved
        name = "velocity.nc" if only else pair_file(record.pair)
        self._path(name)
        write_velocity(self._path(name), velocity)
        record.files.append(name)
        return record

    def _path(self, name: str) -> Path:
        return path_in(self.folder, name, self.while_there)


def given_up(recording: Recording, number: int, reason: str) -> PairRecord:
    """The record of a pair that is set aside for a ``reason`` that lies not in its frames."""
    frames = [frame_entry(recording.frames[k]) for k in recording.pairs[number]]
    return PairRecord(number, frames, set_aside=reason, again=True)


def path_in(folder: Path, name: str, while_there: Path | None) -> Path:
    """The path of a file to be written in a folder of results, whose own folder is made.

    Raises:
        PlenoPIVError: the file ``while_there`` is gone: the run that this is for has ended.
    """
    if while_there is not None and not while_there.exists():
        raise PlenoPIVError(f"{while_there}: the run that this pair belongs to has ended")
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def volume_file(recording: Recording, number: int) -> str:
    """Name of the file of a frame's volume in the results folder."""
    return f"volume-{recording.stem(number)}.h5"


def numbers_of(velocity: xarray.Dataset, voxel_mm: tuple[float, float, float], dt_s: float) -> dict[str, Any]:
    """Of a field: how many vectors, replaced ones and those in a body; the median ratio of peaks; the largest
    displacement (voxels along x, y, z) and velocity (m/s)."""
    return {
        "vectors": int(velocity.valid.size),
        "replaced": int(replaced(velocity).sum()),
        "inside_body": vectors_inside_body(velocity),
        "median_peak_ratio": float(np.nanmedian(velocity.peak_ratio.values)),
        **largest(velocity, voxel_mm, dt_s),
    }


def largest(velocity: xarray.Dataset, voxel_mm: tuple[float, float, float], dt_s: float) -> dict[str, Any]:
    """Of a field, or of tracks: the largest displacement (voxels along x, y, z) and velocity (m/s)."""
    most = [float(np.nanmax(np.abs(velocity[name].values))) for name in "uvw"]
    speed = np.sqrt(velocity.u**2 + velocity.v**2 + velocity.w**2)
    return {
        "largest_displacement_voxels": [1e3 * dt_s * each / d for each, d in zip(most, voxel_mm, strict=True)],
        "largest_velocity_m_s": float(np.nanmax(speed.values)),
    }
