"""``plenopiv track``: particles of all frames, links and fields of all pairs, kept and put together as ``run`` does.

In the folder ``tracking`` of the results: each pair's tracks and field, velocity.nc, summary.json, manifest.jsonl;
beside it tracks.nc. What is finished is kept, whatever ends the run, and the next one of the same inputs goes on from
there.
"""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.experiment import Experiment
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.aside import sweep_asides, written_aside
from plenopiv.io.manifest import hash_of, is_whole
from plenopiv.io.netcdf import read_velocity
from plenopiv.io.output import plain
from plenopiv.io.series_file import pair_file, write_series
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.io.tracks_file import read_tracks, write_tracks
from plenopiv.recording import Recording
from plenopiv.run import space as of_experiment
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.cluster import on_cluster
from plenopiv.run.frame import LostFrame, Progress
from plenopiv.run.inputs import stated_inputs, with_calibration
from plenopiv.run.judged import Judgement, Told, judged
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import PairRecord, largest
from plenopiv.run.plan import plan
from plenopiv.run.series import keep_unchanged
from plenopiv.run.stored import keep_as_they_come, times_of
from plenopiv.run.target import target_calibration
from plenopiv.run.track_frame import FrameTracker, TrackedFrame, own_tracks
from plenopiv.run.track_pair import TrackJob, field_file, tracks_file
from plenopiv.run.track_sequence import METHOD, SequenceJob, check_sequence
from plenopiv.run.track_smooth import SmoothSequence, counted, source
from plenopiv.run.versions import versions
from plenopiv.run.workers import Pool, Workers, started
from plenopiv.run.written import not_in_images
from plenopiv.tracking.covariance import TOGETHER
from plenopiv.tracking.tracks import joined

if TYPE_CHECKING:
    import xarray

FILE, FOLDER = "tracks.nc", "tracking"
OF_A_PAIR = ("links", "nodes_mm", "smoothing", "error_scale", "links_left_out")  # attributes of its field
ON_CPU = "compute.device: plenopiv track computes on this processor, the volumes that it begins with too"
BYTES_A_PIXEL = 60.0  # of a frame, while its particles are fitted
BYTES_AN_ENTRY = 90.0  # of a particle's light in a pixel, while error bars are computed
ABOUT = 1.5  # times the particles of an area are in it and about it
SAMPLE = 100  # points whose pixels are counted for that

log = logging.getLogger("plenopiv")


@dataclass(frozen=True)
class TrackResult:
    """What was written: ``path`` of tracks.nc and ``velocity`` of the field, None where too few tracks make none;
    ``summary``, as summary.json holds it."""

    path: Path
    velocity: Path | None
    summary: dict[str, Any]


def track(
    experiment: Experiment,
    progress: Progress | None = None,
    overwrite: bool = False,
    workers: Workers | int | None = None,
    force: bool = False,
) -> TrackResult:
    """Find the particles of all frames, link those of each pair, make the fields of the links, and write tracks.nc and
    the folder tracking into the output folder. ``workers``: processes of Dask that do it, to the same bits, or how many
    on this machine; by default this process does. ``force``: a recording that the checks call unusable is tracked
    all the same, and says ``quality = "forced"``.

    Raises:
        PlenoPIVError: an input cannot be used; the recording is unusable, or no pair can be tracked; there are tracks
            of other inputs, or of which nothing says what they are made of, and ``overwrite`` is not given; workers
            for the frames of a sequence, which are tracked one after the other. What was finished before is kept.
    """
    report = progress or (lambda stage, done, total: None)
    path, clock = experiment.output_directory / FILE, Clock()
    table = experiment.tracking or TrackingTable()
    sweep_asides(path.parent, f".{FILE}.*.part")
    if path.exists() and not overwrite and not (path.parent / FOLDER).exists():
        raise PlenoPIVError(f"{path}: is already there; use --overwrite, or another output.directory")
    if workers is not None and table.method == METHOD:
        raise PlenoPIVError(
            f'tracking.method: "{METHOD}" takes one frame after the other, each from the ones before: leave out '
            "--workers and --scheduler"
        )
    with (
        kept_warnings() as caught,
        SeriesFolder(path.parent / FOLDER, overwrite) as folder,
        started(workers) as pool,
        ExitStack() as until_tracked,
    ):
        for line in experiment.warnings():
            warnings.warn(line, PlenoPIVWarning, stacklevel=2)
        if experiment.compute.device in ("gpu", "jax-cpu"):
            warnings.warn(ON_CPU, PlenoPIVWarning, stacklevel=2)
        recording = experiment.recording()
        if table.method == METHOD:
            check_sequence(recording)
        inputs = stated_inputs(experiment, recording, force) | {"tracking": table.model_dump(exclude_none=True)}
        folder.begin(inputs)
        with clock("check"):
            target = target_calibration(experiment, recording, progress=report)
            space = of_experiment.space_of(experiment, recording)
            of_experiment.check_view(experiment, target.camera if target else experiment.camera(), space)
            judgement = judged(experiment, recording, force, report, space)
        with clock("calibration"):
            stage = partial(report, "static light of the frames")
            lattice, before = judgement.lattice, folder.calibration
            chain, recording, found = calibrated_chain(experiment, recording, lattice, stage, space, target, before)
        inputs = with_calibration(inputs, chain, recording, found)
        folder.settle(inputs)
        keep_unchanged(folder, recording)
        count = len(recording.pairs)
        if folder.is_complete and len(folder.finished) == count:
            log.info("%s: complete, and nothing has changed; nothing to do", folder.directory)
            folder.discard()
            summary = json.loads((folder.directory / "summary.json").read_text(encoding="utf-8"))
            if not is_whole(path, summary["tracks_sha256"]):
                smooth = _smooth(folder, recording, chain, table)
                write_tracks(path, _tracks(folder, recording, chain, smooth, summary["quality"]))
            return TrackResult(path, _velocity(path), summary)
        tracker = FrameTracker(chain, recording, table.wavelength_nm)
        _tell_memory(tracker, pool)
        records: Iterator[PairRecord]
        if table.method == METHOD:
            job = SequenceJob(tracker, table, judgement.pairs, folder, clock, report)
            left = job.left
            records = job.records(left)
        else:
            anew = replace(tracker)  # without what it has computed
            pairs = TrackJob(anew, table, judgement.pairs, folder.work, source())
            left = [number for number in range(count) if number not in folder.finished]
            if pool is None:
                records = _in_turn(pairs, left, clock, report)
            else:
                records = until_tracked.enter_context(closing(on_cluster(pairs, left, pool, clock, None)))
        told = Told(judgement.findings, [str(one.message) for one in caught])
        for _, stored in sorted(folder.finished.items()):  # an earlier run has said so
            told.add(stored)
        keep_as_they_come(folder, records, told, len(left), count, report)
        said = [*told.said, *(str(one.message) for one in caught)]
        summary = _put_together(folder, recording, chain, table, judgement, path, said, clock, inputs, report)
    return TrackResult(path, _velocity(path), summary)


def _velocity(path: Path) -> Path | None:
    """The field that belongs to ``path`` of tracks.nc, if there is one."""
    velocity = path.parent / FOLDER / "velocity.nc"
    return velocity if velocity.exists() else None


def _in_turn(job: TrackJob, numbers: Sequence[int], clock: Clock, report: Progress) -> Iterator[PairRecord]:
    """The records of the pairs ``numbers``, their files written. A frame that two pairs share is made once, and by
    itself; the second frame of a pair that shares none begins where the first one's particles have moved to."""
    pairs, held = job.recording.pairs, dict[int, TrackedFrame | LostFrame]()
    for number in numbers:
        one, other = pairs[number]
        held = {k: found for k, found in held.items() if k in (one, other)}
        with clock("particles"):
            if one not in held:
                held[one] = job.frame(one, report)
            if other not in held:
                first = held[one]
                held[other] = job.second(other, first, report) if job.follows(number) else job.frame(other, report)
        with clock("links and field"):
            yield job.pair(number, held[one], held[other], report)


def _put_together(
    folder: SeriesFolder,
    recording: Recording,
    chain: Chain,
    table: TrackingTable,
    judgement: Judgement,
    path: Path,
    said: Sequence[str],
    clock: Clock,
    inputs: dict[str, Any],
    report: Progress,
) -> dict[str, Any]:
    """Make tracks.nc, velocity.nc and the summary of all pairs' files, and move them into place.

    Raises:
        PlenoPIVError: no pair could be tracked, or a file cannot be written.
    """
    records = [folder.finished[number] for number in range(len(recording.pairs))]
    good = [record for record in records if record["set_aside"] is None]
    tracked = [record for record in records if "particles" in record["numbers"]]
    if not tracked:
        folder.discard()
        raise PlenoPIVError(f"no pair can be tracked: {records[0]['set_aside']}")
    folder.check_whole()
    files = ["summary.json"]
    with clock("links and field"):
        smooth = _smooth(folder, recording, chain, table)
        if smooth is None:
            fields = {r["pair"]: folder.there(field_file(r["pair"], len(records))) for r in good}
        else:
            quality = {record["pair"]: judgement.pairs.quality(record["findings"]) for record in good}
            fields, without = smooth.write_fields(quality, folder, chain, table, report)
            records = [record | {"set_aside": without.get(record["pair"], record["set_aside"])} for record in records]
            files += [pair_file(number) for number in fields]
    said_of_all = judgement.summary(records)
    tracks = _tracks(folder, recording, chain, smooth, said_of_all["quality"])
    if not np.isfinite(tracks["u"].values).any():
        folder.discard()
        raise PlenoPIVError(f"no pair can be tracked: {records[0]['set_aside']}")
    if fields and len(records) > 1:
        like = read_velocity(next(iter(fields.values())))
        like.attrs = {key: value for key, value in like.attrs.items() if key not in OF_A_PAIR}
        write_series(folder.path("velocity.nc"), like, times_of(recording), fields, {"quality": said_of_all["quality"]})
        files.append("velocity.nc")
    measured = map(read_velocity, fields.values()) if fields else [tracks]
    moved = [largest(each, chain.grid.voxel_mm, recording.dt_s) for each in measured]
    names = recording.names
    particles = {
        names[k]: n for r in tracked for k, n in zip(recording.pairs[r["pair"]], r["numbers"]["particles"], strict=True)
    }
    linked = [r["numbers"].get("linked", 0) for r in records]
    if smooth is not None:  # smooth tracks are fewer: outlying ones are left out
        counts, linked = counted(tracks, len(recording))
        particles = {name: n for name, n in zip(names, counts, strict=True) if name in particles}
    std = [r["numbers"]["median_std_mm"] for r in tracked if "median_std_mm" in r["numbers"]]
    summary = {
        "not_in_images": not_in_images(moved, recording),
        "pairs": len(records),
        **said_of_all,
        "particles": particles,
        "linked": linked,
        "median_std_mm": np.median(std, 0).tolist() if std else None,
        "frame": chain.frame,
        "warnings": list(dict.fromkeys(said)),
        "versions": versions(),
        "seconds": clock.seconds,
        "peak_gb": clock.peak_gb,
        "inputs_sha256": folder.depends,
    }
    with written_aside(path) as staged:  # the old ones stay until all else is there
        write_tracks(staged, tracks)
        summary["tracks_sha256"] = hash_of(staged)
        folder.write_text("summary.json", json.dumps(plain(summary), indent=2, allow_nan=False) + "\n")
        folder.publish(files, inputs)
    return summary


def _smooth(folder: SeriesFolder, recording: Recording, chain: Chain, table: TrackingTable) -> SmoothSequence | None:
    """The smooth tracks of a sequence that is tracked over many frames."""
    return SmoothSequence.of(folder, recording, chain.camera) if table.method == METHOD else None


def _tracks(
    folder: SeriesFolder, recording: Recording, chain: Chain, smooth: SmoothSequence | None, quality: str
) -> xarray.Dataset:
    """The tracks of all pairs' files, or those that are ``smooth``; ``quality``: of all pairs together."""
    if smooth is not None:
        tracks = own_tracks(smooth.dataset(), chain.grid)
        tracks.attrs["frame"] = chain.frame
    else:
        files = [tracks_file(k) for k, record in sorted(folder.finished.items()) if tracks_file(k) in record["files"]]
        tracks = joined([read_tracks(folder.there(name)) for name in files])
    if recording.is_sequence:  # the time between pairs of pulses is not known
        said = {"units": "s", "long_name": "time of the frame, from the first frame of the recording"}
        tracks["time"] = "obs", tracks["frame"].values * recording.dt_s, said
    numbers = np.unique(tracks["frame"].values).tolist()
    tracks.attrs |= {
        "Conventions": "CF-1.11",
        "title": "Particles and their tracks",
        "quality": quality,
        "frames": stated_frames(recording.names, numbers),
    }
    return tracks


def stated_frames(names: Sequence[str], numbers: Sequence[int]) -> list[str]:
    """Frames by number and name as an attribute states them: HDF5 takes UTF-8 alone, names of files may be others."""
    return [f"{k}: {printable(names[k])}" for k in numbers]


def _tell_memory(tracker: FrameTracker, pool: Pool | None) -> None:
    """Say what memory a run takes, each worker of a ``pool``, and what the particles of a frame take besides."""
    chain = tracker.chain
    low, high = np.transpose(chain.lens_grid.limits_mm())
    points = np.random.default_rng(0).uniform(low, high, (SAMPLE, 3))
    entries = float(tracker.of_points(points).start[-1]) / SAMPLE
    pixels = chain.camera.sensor.rows * chain.camera.sensor.columns
    log.info(
        "memory: %sabout %.2g GB, and at most %.2g GB for the particles of a frame",
        "" if pool is None else "each worker ",
        plan(chain).needed.peak / 1e9,
        (pixels * BYTES_A_PIXEL + ABOUT * TOGETHER * entries * BYTES_AN_ENTRY) / 1e9,
    )
