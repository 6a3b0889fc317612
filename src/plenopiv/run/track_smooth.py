"""The smooth tracks of a sequence, and the field of each pair from them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import pair_file
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run.frame import Progress
from plenopiv.run.track_field import velocity_of_tracks
from plenopiv.run.track_sequence import frame_file, read_frame
from plenopiv.run.versions import versions
from plenopiv.tracking.sightings import SeenFrame
from plenopiv.tracking.tracks import smooth_dataset
from plenopiv.tracking.trajectories import between, trajectories

if TYPE_CHECKING:
    import xarray


def source() -> str:
    """What files say that they come from."""
    return f"plenopiv {versions()['plenopiv']}"


def frames_of(folder: SeriesFolder, recording: Recording) -> list[SeenFrame]:
    """The frames of a sequence that are in the files of its pairs, in the order of time."""
    paths = {number: folder.there(frame_file(number)) for number in range(len(recording))}
    return [read_frame(path, number).seen for number, path in paths.items() if path.exists()]


def smooth_tracks(folder: SeriesFolder, recording: Recording) -> xarray.Dataset:
    """The dataset of all frames' particles on smooth tracks."""
    frames = frames_of(folder, recording)
    found = trajectories(frames)
    out = smooth_dataset([(one.number, one.particles) for one in frames], found, recording.dt_s)
    out.attrs |= {
        "dt_s": recording.dt_s,
        "source": source(),
        "jerk_m_s3": (found.motion.jerk * 1e-3 / recording.dt_s**3).tolist(),
        "jerk_memory_s": (found.motion.memory * recording.dt_s).tolist(),
        "error_scale": found.motion.noise.tolist(),
    }
    return out


def fields_of_tracks(
    folder: SeriesFolder,
    recording: Recording,
    chain: Chain,
    table: TrackingTable,
    pairs: Sequence[int],
    report: Progress,
) -> dict[int, Path]:
    """Write the field of each of the ``pairs`` from the smooth tracks half way between its frames; the files.

    Raises:
        PlenoPIVError: a file cannot be written, or there are too few tracks between all frames.
    """
    found, out, why = trajectories(frames_of(folder, recording)), dict[int, Path](), None
    for number in pairs:
        stage, time_s = partial(report, f"field {number + 1} of the tracks"), recording.mid_time_s(number)
        try:
            velocity = velocity_of_tracks(between(found, number), chain, table, recording.dt_s, time_s, stage)
        except PlenoPIVError as error:
            why = error
            warnings.warn(f"pair {number}: no field of its tracks: {error}", PlenoPIVWarning, stacklevel=2)
            continue
        velocity.attrs["source"] = source()
        out[number] = folder.path(pair_file(number))
        write_velocity(out[number], velocity)
    if not out and why is not None:
        raise why
    return out
