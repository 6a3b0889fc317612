"""A pair of frames tracked and written: what a series of ``plenopiv track`` repeats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import pair_file
from plenopiv.io.tracks_file import write_tracks
from plenopiv.recording import Recording
from plenopiv.run.frame import LostFrame, Progress, taken_or_lost
from plenopiv.run.judged import PairJudge
from plenopiv.run.pair import PairRecord, given_up, path_in
from plenopiv.run.track_field import of_links, velocity_of_tracks
from plenopiv.run.track_frame import FrameTracker, TrackedFrame, own, own_tracks
from plenopiv.tracking.expected import expected
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import Links, link
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.tracks import tracks_dataset
from plenopiv.volume import SparseVolume, VoxelGrid

SCATTER_VOXELS = 0.7  # first guess of how far correlation is from a particle's displacement
NO_FIELD = "no field of its tracks"
FARTHER = 3.0  # times the largest displacement of the correlation is the largest of a particle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackJob:
    """What tracks every pair of a recording, judges it and writes it below ``folder``. ``while_there``: on a worker,
    the file without which the run has ended, and nothing is written."""

    tracker: FrameTracker
    table: TrackingTable
    judge: PairJudge
    folder: Path
    source: str
    while_there: Path | None = None

    @property
    def chain(self) -> Chain:
        """Of the tracker."""
        return self.tracker.chain

    @property
    def recording(self) -> Recording:
        """Of the tracker."""
        return self.tracker.recording

    def follows(self, number: int) -> bool:
        """Whether a pair's second frame begins where the particles of its first are expected: where no other pair
        shares either."""
        pairs = self.recording.pairs
        return sum(k in pair for pair in pairs for k in pairs[number]) == 2

    def given_up(self, number: int, reason: str) -> PairRecord:
        """The record of a pair that is set aside for a ``reason`` that lies not in its frames."""
        return given_up(self.recording, number, reason)

    def frame(self, number: int, report: Progress) -> TrackedFrame | LostFrame:
        """Frame ``number``, from 0.

        Raises:
            PlenoPIVError: its file is gone since the run began: others will be too, and the cause can be removed.
        """
        return taken_or_lost(self.recording, number, partial(self.tracker.frame, number, report))

    def second(self, number: int, first: TrackedFrame | LostFrame, report: Progress) -> TrackedFrame | LostFrame:
        """Frame ``number``, whose particles begin where those of the ``first`` frame of its pair are expected.

        Raises:
            PlenoPIVError: as ``frame``.
        """
        if isinstance(first, LostFrame):
            return self.frame(number, report)
        chain, before, moved = self.chain, first, list[DisplacementField]()

        def guess(volume: SparseVolume) -> tuple[Array, Array] | None:
            try:
                moved.append(chain.displacement(before.volume, volume, report))
            except PlenoPIVError:
                return None  # ``pair`` says why
            place, light = peaks(volume)
            if chain.space is not None:
                place = chain.space.to_laboratory(place)
            return expected(before.particles, place, light, *search(moved[0], chain.grid, self.table))

        found = taken_or_lost(self.recording, number, partial(self.tracker.frame, number, report, guess))
        return replace(found, moved=moved[0]) if moved and isinstance(found, TrackedFrame) else found

    def pair(
        self, number: int, before: TrackedFrame | LostFrame, after: TrackedFrame | LostFrame, report: Progress
    ) -> PairRecord:
        """Link the particles of a pair's frames, make the field of these links, and write both.

        Raises:
            PlenoPIVError: a file cannot be written; there are no links in the only pair.
        """
        recording, chain = self.tracker.recording, self.tracker.chain
        only, dt_s = len(recording.pairs) == 1, recording.dt_s
        record = PairRecord(number, [before.entry, after.entry], warnings=[*before.warned, *after.warned])
        if isinstance(before, LostFrame) or isinstance(after, LostFrame):
            record.set_aside = next(one.reason for one in (before, after) if isinstance(one, LostFrame))
            if only:
                raise PlenoPIVError(record.set_aside)
            return record
        found, record.set_aside = self.judge.of_images(before.shown, after.shown)
        record.findings += map(asdict, found)
        if record.set_aside is not None:
            return record
        first, second = before.particles, after.particles
        with record.measuring(only):
            moved = after.moved
            if moved is None:
                moved = chain.displacement(before.volume, after.volume, report)
            links = linked(first, second, moved, chain.grid, self.table)
        if record.set_aside is not None:
            return record
        tracks = tracks_dataset(
            [(before.number, first), (after.number, second)], [(before.number, after.number, links)], dt_s
        )
        tracks = own_tracks(tracks, chain.grid)
        said = {"source": self.source, "quality": self.judge.quality(record.findings)}
        tracks.attrs |= {"dt_s": dt_s, "frame": chain.frame} | said
        here, there = (own(each.position_mm, chain.grid) for each in (first, second))
        record.numbers = median_std(first.covariance[here]) | {
            "particles": [int(here.sum()), int(there.sum())],
            "linked": int(here[links.a].sum()),
            "left_by_correlation_mm": links.scatter_mm.tolist(),
        }
        stage, time_s = partial(report, "field of the tracks"), recording.mid_time_s(number)
        with record.measuring(only=False):
            velocity = velocity_of_tracks(of_links(first, second, links), chain, self.table, dt_s, time_s, stage)
        name, field = tracks_file(number), field_file(number, len(recording.pairs))
        write_tracks(path_in(self.folder, name, self.while_there), tracks)
        record.files.append(name)
        if record.set_aside is not None:  # its tracks are there all the same
            record.set_aside = f"{NO_FIELD}: {record.set_aside}"
            return record
        velocity["time"].attrs["long_name"] = recording.time_meaning
        velocity.attrs |= said
        write_velocity(path_in(self.folder, field, self.while_there), velocity)
        record.files.append(field)
        record.numbers |= {"measured": int(velocity.valid.sum()), "vectors": int(velocity.valid.size)}
        return record


def median_std(covariance: Array) -> dict[str, Any]:
    """The median standard deviations of particles of ``covariance`` (n, 4, 4) for a record; nothing where there are
    none."""
    if not len(covariance):
        return {}
    return {"median_std_mm": np.sqrt(np.median(np.einsum("nii->ni", covariance), 0))[:3].tolist()}


def field_file(number: int, pairs: int) -> str:
    """Name of the file of the field of pair ``number``, from 0, of so many ``pairs``: of one it is that of all."""
    return "velocity.nc" if pairs == 1 else pair_file(number)


def tracks_file(number: int) -> str:
    """Name of the file of a pair's tracks, from 0, in the folder of the tracking."""
    return f"pairs/tracks-{number:04d}.nc"


def linked(
    first: FrameParticles, second: FrameParticles, field: DisplacementField, grid: VoxelGrid, table: TrackingTable
) -> Links:
    """The links of a pair, the correlation's ``field`` (voxels of ``grid``) saying where to look."""
    return link(first, second, *search(field, grid, table))


def search(
    field: DisplacementField, grid: VoxelGrid, table: TrackingTable
) -> tuple[Callable[[Array], Array], Array, float]:
    """Displacements to expect, how far they may be off and how large they may be, in mm, as ``links.link`` takes
    them."""
    most = table.max_displacement_mm
    if most is None:
        lengths = np.linalg.norm(field.displacement * np.reshape(grid.voxel_mm, (3, 1, 1, 1)), axis=0)
        most = FARTHER * float(np.nanmax(lengths)) + grid.voxel_mm[2]
    return predictor(field, grid), SCATTER_VOXELS * np.asarray(grid.voxel_mm), most


def predictor(field: DisplacementField, grid: VoxelGrid) -> Callable[[Array], Array]:
    """Displacements (n, 3) in mm at points (n, 3) in mm of a field in voxels: linear between vectors, beyond them as at
    the nearest one; 0 in a body."""
    axes = [np.asarray(axis, np.float64) for axis in (field.z, field.y, field.x)]
    values = np.nan_to_num(np.moveaxis(field.displacement, 0, -1)) * np.asarray(grid.voxel_mm)
    for k, axis in enumerate(axes):
        if len(axis) == 1:  # one layer of windows
            axes[k], values = np.array([axis[0], axis[0] + 1.0]), np.repeat(values, 2, k)
    between = RegularGridInterpolator(axes, values)
    low, high = (np.array([end(axis) for axis in axes]) for end in (np.min, np.max))

    def at(points_mm: Array) -> Array:
        index = (points_mm - np.asarray(grid.first_mm)) / np.asarray(grid.voxel_mm)
        return np.asarray(between(np.clip(index[:, ::-1], low, high)))

    return at
