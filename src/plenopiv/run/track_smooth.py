"""The smooth tracks of a sequence, and the field of each pair from them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import pair_file
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run.frame import Progress
from plenopiv.run.track_field import velocity_of_tracks
from plenopiv.run.track_pair import NO_FIELD
from plenopiv.run.track_sequence import frames_kept, read_frame
from plenopiv.run.versions import versions
from plenopiv.tracking.light import prior_std_mm
from plenopiv.tracking.sightings import SeenFrame
from plenopiv.tracking.tracks import smooth_dataset
from plenopiv.tracking.trajectories import Trajectories, between, trajectories

if TYPE_CHECKING:
    import xarray


def source() -> str:
    """What files say that they come from."""
    return f"plenopiv {versions()['plenopiv']}"


def counted(tracks: xarray.Dataset, frames: int) -> tuple[list[int], list[int]]:
    """Of ``tracks`` as tracks.nc has them: particles in each of so many ``frames``, and how many of each frame are in
    the next one, too."""
    frame, track = tracks["frame"].values, tracks["track_id"].values
    ids = [track[(frame == k) & (track >= 0)] for k in range(frames)]
    linked = [int(np.isin(after, before).sum()) for before, after in pairwise(ids)]
    return np.bincount(frame, minlength=frames).tolist(), linked


@dataclass(frozen=True)
class SmoothSequence:
    """The particles of all frames of a ``recording``, in the order of time, and their smooth tracks."""

    recording: Recording
    frames: Sequence[SeenFrame]
    found: Trajectories

    @classmethod
    def of(cls, folder: SeriesFolder, recording: Recording, camera: PlenopticCamera) -> SmoothSequence:
        """From the files of the frames."""
        kept = frames_kept(folder, range(len(recording)))
        frames = [read_frame(path, number).seen for number, path in kept.items()]
        return cls(recording, frames, trajectories(frames, prior_std_mm(camera)))

    def dataset(self) -> xarray.Dataset:
        """All particles of all frames."""
        dt_s, motion = self.recording.dt_s, self.found.motion
        out = smooth_dataset([(one.number, one.particles) for one in self.frames], self.found, dt_s)
        out.attrs |= {
            "dt_s": dt_s,
            "source": source(),
            "jerk_m_s3": (motion.jerk * 1e-3 / dt_s**3).tolist(),
            "jerk_memory_s": (motion.memory * dt_s).tolist(),
            "error_scale": motion.noise.tolist(),
            "outlying_tracks": self.found.outlying,
        }
        return out

    def write_fields(
        self, pairs: Mapping[int, str], folder: SeriesFolder, chain: Chain, table: TrackingTable, report: Progress
    ) -> tuple[dict[int, Path], dict[int, str]]:
        """Write the field of each of the ``pairs``, whose quality is given, from the tracks half way between its
        frames; the files, and why other pairs have none: there are too few, say.

        Raises:
            PlenoPIVError: a file cannot be written.
        """
        out, without = dict[int, Path](), dict[int, str]()
        for number, quality in pairs.items():
            tracks, time_s = between(self.found, number), self.recording.mid_time_s(number)
            stage = partial(report, f"field {number + 1} of the tracks")
            try:
                velocity = velocity_of_tracks(tracks, chain, table, self.recording.dt_s, time_s, stage)
            except PlenoPIVError as error:
                without[number] = f"{NO_FIELD}: {error}"
                warnings.warn(f"pair {number}: {NO_FIELD}: {error}", PlenoPIVWarning, stacklevel=2)
                continue
            velocity["time"].attrs["long_name"] = self.recording.time_meaning
            velocity.attrs |= {"source": source(), "quality": quality}
            out[number] = folder.path(pair_file(number))
            write_velocity(out[number], velocity)
        return out, without
