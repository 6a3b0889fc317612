"""All pairs of a recording: images -> volumes -> displacements -> velocity -> results folder.

Each frame is reconstructed once; each pair is measured, written and forgotten. What is finished is kept, whatever ends
the run, and the next one of the same inputs goes on from there.
"""

from __future__ import annotations

import json
import logging
import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run import duration
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.frame import Progress
from plenopiv.run.in_turn import in_turn
from plenopiv.run.inputs import changed_frame, stated_inputs, with_calibration
from plenopiv.run.judged import Told, judged
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import Job
from plenopiv.run.plan import Plan, plan
from plenopiv.run.shown import Shown
from plenopiv.run.written import Score, source, summary_of, write_results

if TYPE_CHECKING:
    import xarray

log = logging.getLogger("plenopiv")
BYTES_A_VECTOR = 80.0  # of a pair's file, at most
BYTES_A_VOXEL = 5.0  # kept, of a volume's file
LEAST_KEPT = 0.01  # share of the voxels that a volume keeps


@dataclass(frozen=True)
class RunResult:
    """What ``summary.json`` holds of a run, and where all is. ``measured``: how many pairs are finished of how many;
    with ``run(pairs=...)`` there is no more than that, and no field yet."""

    summary: dict[str, Any]
    directory: Path
    measured: tuple[int, int] = (1, 1)

    @cached_property
    def velocity(self) -> xarray.Dataset:
        """The field of velocity.nc, dims (time, z, y, x): of one pair in memory, of a series read as it is asked for.

        Raises:
            PlenoPIVError: there is none yet, or it was removed.
        """
        from plenopiv.io.netcdf import read_velocity
        from plenopiv.io.series_file import open_series

        path = self.directory / "velocity.nc"
        return read_velocity(path) if self.measured[1] == 1 or not path.exists() else open_series(path)


def run(
    experiment: Experiment,
    progress: Progress | None = None,
    overwrite: bool = False,
    score: Score | None = None,
    memory_gb: float | None = None,
    force: bool = False,
    pairs: tuple[int, int] | None = None,
) -> RunResult:
    """Run the whole chain and write the results folder: velocity.nc, summary.json, experiment.toml, report.html
    and its figures, manifest.jsonl; of several pairs a file each in pairs/.

    ``progress(stage, done, total)`` is called as work proceeds. ``overwrite``: results of other inputs are replaced,
    and are whole until then. ``score``, where the truth is known, turns the velocity field into measures for the
    report; a run itself never reads a truth. ``memory_gb``: a run that would take more is cut into tiles, or does not
    begin where these would not help. ``force``: a recording that the checks call unusable is measured all the same, and
    its field carries ``quality = "forced"``. ``pairs``: the first and last pair to measure, from 0; results are then
    not put together, which a run without it does.

    Raises:
        PlenoPIVError: an input cannot be used, the recording is unusable, memory or disk does not suffice, the folder
            holds results of other inputs, or another run works in it. What was finished before is kept.
    """
    report = progress or (lambda stage, done, total: None)
    clock = Clock()
    begin, end = (0, None) if pairs is None else (pairs[0], pairs[1] + 1)
    with kept_warnings() as caught, SeriesFolder(experiment.output_directory, overwrite, begin, end) as folder:
        for line in experiment.warnings():
            warnings.warn(line, PlenoPIVWarning, stacklevel=2)
        recording = experiment.recording()
        wanted = _wanted(recording, pairs)
        inputs = stated_inputs(experiment, recording, force)
        folder.begin(inputs)
        with clock("check"):
            judgement = judged(experiment, recording, force, report)
        with clock("calibration"):
            stage = partial(report, "static light of the frames")
            chain, recording, calibration = calibrated_chain(experiment, recording, judgement.check.lattice, stage)
        _tell_static_light(calibration)
        inputs = with_calibration(inputs, chain, recording)
        folder.settle(inputs)
        _keep_unchanged(folder, recording)
        if folder.is_complete:
            log.info("%s: complete, and nothing has changed; nothing to do", folder.directory)
            return _as_it_is(folder, recording)
        planned = plan(chain, memory_gb)
        left = [number for number in wanted if number not in folder.finished]
        _tell_plan(planned, recording, left)
        _ask_for_space(folder, planned, recording, left, experiment.output.volumes)

        job = Job(planned.chain, recording, judgement.pairs, folder.work, source(experiment), experiment.output.volumes)
        before = [str(w.message) for w in caught]
        told, shown = Told(judgement.findings, before), Shown(planned.chain, recording, clock, folder.finished)
        try:
            for done, record in enumerate(in_turn(job, left, planned, clock, report, shown), 1):
                kept = folder.store(record.content(), record.files)
                for said in told.add(kept):
                    warnings.warn(said, PlenoPIVWarning, stacklevel=2)
                if len(left) > 1:
                    report("pairs", done, len(left))
        except BaseException:
            _tell_kept(folder, recording)
            raise
        if pairs is not None:
            done = sum(number in folder.finished for number in range(len(recording.pairs)))
            return RunResult({}, folder.directory, (done, len(recording.pairs)))
        records = [folder.finished[number] for number in range(len(recording.pairs))]
        if all(record["set_aside"] is not None for record in records):
            folder.discard()
            raise PlenoPIVError(f"no pair can be measured: {records[0]['set_aside']}")
        told = Told(judgement.findings, before)
        for entry in records:
            told.add(entry)
        summary = summary_of(experiment, recording, records, calibration, judgement, planned, told.said, clock)
        summary |= {"inputs_sha256": folder.depends}
        first = shown.of(records, report)
        files = write_results(folder, experiment, recording, records, summary, first, score, clock)
        folder.publish(files, inputs)
    return RunResult(summary, experiment.output_directory, (len(records), len(records)))


def _wanted(recording: Recording, pairs: tuple[int, int] | None) -> list[int]:
    """Numbers of the pairs to measure.

    Raises:
        PlenoPIVError: there are no such pairs.
    """
    count = len(recording.pairs)
    if pairs is None:
        return list(range(count))
    if not 0 <= pairs[0] <= pairs[1] < count:
        raise PlenoPIVError(f"--pairs {pairs[0]}-{pairs[1]}: the recording has pairs 0 to {count - 1}")
    return list(range(pairs[0], pairs[1] + 1))


def _keep_unchanged(folder: SeriesFolder, recording: Recording) -> None:
    """Forget pairs that were set aside and whose frames are others now; say what is kept and what is damaged.

    Raises:
        PlenoPIVError: a frame that was measured is another one now.
    """
    for number, record in list(folder.finished.items()):
        if number >= len(recording.pairs):
            raise PlenoPIVError(
                f"{folder.directory}: holds {max(folder.finished) + 1} pairs, the recording {len(recording.pairs)}; "
                "use --overwrite, or another output.directory"
            )
        changed = changed_frame(recording, record)
        if changed is None:
            continue
        if record["set_aside"] is None:
            raise PlenoPIVError(
                f"{folder.directory}: holds a run of other frames ({changed}); use --overwrite, or another "
                "output.directory"
            )
        del folder.finished[number]
    for words in folder.words:
        log.info("%s", words)
    if folder.finished:
        log.info("%d of %d pairs are finished and whole: they are kept", len(folder.finished), len(recording.pairs))


def _as_it_is(folder: SeriesFolder, recording: Recording) -> RunResult:
    """The results that are there."""
    folder.discard()
    summary = json.loads((folder.directory / "summary.json").read_text(encoding="utf-8"))
    return RunResult(summary, folder.directory, (len(recording.pairs), len(recording.pairs)))


def _tell_static_light(calibration: Mapping[str, Any]) -> None:
    if stated := calibration.get("static_light"):
        log.info(
            "static light: estimated from %d frames, to %.1f counts (RMS); it holds %.2f of the %.0f counts that "
            "particles give a pixel on the mean",
            *(stated[key] for key in ("frames", "error_counts", "particle_light_left_counts", "particle_light_counts")),
        )


def _tell_plan(planned: Plan, recording: Recording, left: Sequence[int]) -> None:
    frames = {k for number in left for k in recording.pairs[number]}
    log.info("memory: about %.2g GB", planned.needed.peak / 1e9)
    log.info("time: about %s", duration.as_text(planned.takes.run(len(frames), len(left))))


def _ask_for_space(
    folder: SeriesFolder, planned: Plan, recording: Recording, left: Sequence[int], volumes: bool
) -> None:
    """Compare the space on disk with what the files of the pairs take at least.

    Raises:
        PlenoPIVError: it does not suffice.
    """
    grid, correlation = planned.chain.grid, planned.chain.correlation
    vectors = prod(window_grid(grid.shape, correlation.windows[-1], correlation.overlap).shape)
    needed = len(left) * vectors * BYTES_A_VECTOR
    if volumes:
        frames = {k for number in left for k in recording.pairs[number]}
        needed += len(frames) * BYTES_A_VOXEL * LEAST_KEPT * grid.size
    free = shutil.disk_usage(folder.work).free
    if needed > free:
        raise PlenoPIVError(
            f"{folder.directory}: its disk has {free / 1e9:.2g} GB left, {len(left)} pairs take about "
            f"{needed / 1e9:.2g} GB; make room, or take another output.directory"
        )


def _tell_kept(folder: SeriesFolder, recording: Recording) -> None:
    if folder.finished:
        done, count = len(folder.finished), len(recording.pairs)
        log.info("%d of %d pairs are finished and kept; the same command goes on from there", done, count)
