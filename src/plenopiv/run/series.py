"""All pairs of a recording: images -> volumes -> displacements -> velocity -> results folder.

Each frame is reconstructed once; each pair is measured, written and forgotten. What is finished is kept, whatever ends
the run, and the next one of the same inputs goes on from there.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.calibration.target.calibrated import TargetCalibration
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.device.backend import device_of
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.series_file import pair_file
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run import space as of_experiment
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.cluster import on_cluster
from plenopiv.run.frame import Progress
from plenopiv.run.in_turn import in_turn
from plenopiv.run.inputs import changed_frame, stated_inputs, with_calibration
from plenopiv.run.judged import judged
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import Job
from plenopiv.run.plan import plan
from plenopiv.run.present import as_it_is_now, remember
from plenopiv.run.share import limit_of_worker, shared_plan
from plenopiv.run.shown import Shown
from plenopiv.run.stored import StoredSeries, ask_for_space, summary_there, tell_kept, tell_plan, times_of
from plenopiv.run.target import target_calibration
from plenopiv.run.workers import Workers, started
from plenopiv.run.written import Score, source

if TYPE_CHECKING:
    import xarray

log = logging.getLogger("plenopiv")


@dataclass(frozen=True)
class RunResult:
    """What ``summary.json`` holds of a run, and where all is. ``measured``: how many pairs are finished of how many;
    with ``run(pairs=...)`` there is no more than that and which of these pairs were set aside, and no field, unless an
    earlier run has put all together."""

    summary: dict[str, Any]
    directory: Path
    measured: tuple[int, int] = (1, 1)

    def __repr__(self) -> str:
        vectors, replaced = self.summary.get("vectors", 0), self.summary.get("replaced_share", 0.0)
        done, pairs = self.measured
        return (
            f"<RunResult {self.directory}: {done} of {pairs} pairs, {vectors} vectors, {100 * replaced:.2g} % replaced>"
        )

    @property
    def is_together(self) -> bool:
        """Whether the results are those of all pairs."""
        return "vectors" in self.summary and self.measured[0] == self.measured[1]

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
    workers: Workers | int | None = None,
    space: SpaceMap | None = None,
    target: TargetCalibration | None = None,
    device: str | None = None,
) -> RunResult:
    """Run the whole chain and write the results folder: velocity.nc, summary.json, experiment.toml, report.html
    and its figures, manifest.jsonl; of several pairs a file each in pairs/.

    ``progress(stage, done, total)`` is called as work proceeds. ``overwrite``: results of other inputs are replaced,
    and are whole until then. ``score``, where the truth is known, turns the velocity field into measures for the
    report; a run itself never reads a truth. ``memory_gb``: a run that would take more is cut into tiles, or does not
    begin where these would not help. ``force``: a recording that the checks call unusable is measured all the same, and
    its field carries ``quality = "forced"``. ``pairs``: the first and last pair to measure, from 0; results are then
    not put together, which a run without it does. ``workers``: so many processes on this machine, or those of a Dask
    scheduler, measure the pairs, with the same bits; ``memory_gb`` is then of all processes on this machine, or of each
    of a scheduler's workers. ``space``: the map between the laboratory, whose x, y, z those of the experiment then are,
    and lens space, ``target``: the camera calibrated with a target, where they are known otherwise than from the
    experiment's calibration. ``device``: another ``compute.device`` than the experiment's.

    Raises:
        PlenoPIVError: an input cannot be used, the device is not there, the recording is unusable, memory or disk does
            not suffice, the folder holds results of other inputs, another run works in it, or the scheduler is gone.
            What was finished before is kept.
    """
    report = progress or (lambda stage, done, total: None)
    if pairs is not None and not (len(pairs) == 2 and 0 <= pairs[0] <= pairs[1]):
        raise PlenoPIVError(f"pairs: {pairs}, give the first and the last one, counted from 0")
    if memory_gb is not None and not memory_gb > 0:
        raise PlenoPIVError(f"memory: {memory_gb} GB, give a positive number")
    clock, experiment = Clock(), experiment.on_device(device)
    computing = device_of(experiment.compute.device, experiment.compute.device_memory_gb)
    begin, end = (0, None) if pairs is None else (pairs[0], pairs[1] + 1)
    opened = SeriesFolder(experiment.output_directory, overwrite, begin, end)
    with kept_warnings() as caught, opened as folder, ExitStack() as until_measured:
        for line in experiment.warnings():
            warnings.warn(line, PlenoPIVWarning, stacklevel=2)
        recording = experiment.recording()
        wanted = _wanted(recording, pairs)
        inputs = stated_inputs(experiment, recording, force, computing)
        folder.begin(inputs)
        pool = until_measured.enter_context(started(workers, limit_of_worker(workers, memory_gb)))
        with clock("check"):
            target = target or target_calibration(experiment, recording, progress=report)
            space = space or of_experiment.space_of(experiment, recording)
            of_experiment.check_view(experiment, target.camera if target else experiment.camera(), space)
            judgement = judged(experiment, recording, force, report, space)
        with clock("calibration"):
            stage = partial(report, "static light of the frames")
            lattice = judgement.lattice
            chain, recording, calibration = calibrated_chain(
                experiment, recording, lattice, stage, space, target, folder.calibration
            )
        _tell_static_light(calibration)
        chain = chain.on_device(computing.shared_by(pool.workers.count if pool else None))
        planned, share = (plan(chain, memory_gb), None) if pool is None else shared_plan(chain, memory_gb, pool.workers)
        inputs = with_calibration(inputs, chain, recording, calibration)
        inputs |= {"tiles": planned.tiles}  # these give other bits
        folder.settle(inputs)
        keep_unchanged(folder, recording)
        if folder.is_complete and all(number in folder.finished for number in wanted):
            there = summary_there(folder)
            there["set_aside"] = [each for each in there["set_aside"] if each["pair"] in wanted]
            return RunResult(there, folder.directory, (folder.recorded(), len(recording.pairs)))
        left = [number for number in wanted if number not in folder.finished]
        frames = len({k for number in left for k in recording.pairs[number]})
        if pool is None or pool.workers.count:  # a scheduler's workers are other machines
            planned = as_it_is_now(planned)
        tell_plan(planned, frames, len(left), None if share is None else share.text)
        wanted_too: dict[str, Any] = {"volumes": experiment.output.volumes, "gradients": experiment.output.gradients}
        volumes, gradients = frames if experiment.output.volumes else 0, experiment.output.gradients
        ask_for_space(folder, planned, len(left), len(recording.pairs), gradients, volumes)

        job = Job(planned.chain, recording, judgement.pairs, folder.work, source(experiment), **wanted_too)
        before = [str(w.message) for w in caught]
        shown = Shown(planned.chain, recording, clock, folder.finished)
        series = StoredSeries(
            folder,
            experiment,
            recording,
            times_of(recording),
            inputs,
            judgement,
            calibration,
            planned,
            clock,
            report,
            before,
        )
        turns = partial(in_turn, planned=planned, report=report) if pool is None else partial(on_cluster, pool=pool)
        with closing(turns(job, left, clock=clock, shown=shown)) as records:
            series.store(records, len(left))
        until_measured.close()
        remember(planned)
        if pairs is not None:
            aside = judgement.summary([folder.finished[number] for number in wanted])["set_aside"]
            return RunResult({"set_aside": aside}, folder.directory, (folder.recorded(), len(recording.pairs)))
        summary = series.put_together(shown.of, score)
    return RunResult(summary, experiment.output_directory, (len(recording.pairs), len(recording.pairs)))


def _wanted(recording: Recording, pairs: tuple[int, int] | None) -> list[int]:
    """Numbers of the pairs to measure; the last of array jobs may ask for more than there are.

    Raises:
        PlenoPIVError: there are no such pairs.
    """
    count = len(recording.pairs)
    if pairs is None:
        return list(range(count))
    if pairs[0] >= count:
        raise PlenoPIVError(f"--pairs {pairs[0]}-{pairs[1]}: the recording has pairs 0 to {count - 1}")
    if pairs[1] >= count:
        log.info("--pairs %d-%d: the recording ends with pair %d", *pairs, count - 1)
    return list(range(pairs[0], min(pairs[1] + 1, count)))


def keep_unchanged(folder: SeriesFolder, recording: Recording) -> None:
    """Forget pairs that were set aside and whose frames are others now, with ``folder.overwrite`` also those that were
    measured and pairs that are gone; and a pair whose field is named as that of a pair alone where there are several
    now, or the other way. Say what is kept and what is damaged.

    Raises:
        PlenoPIVError: a frame that was measured is another one now, and not ``folder.overwrite``.
    """
    count = len(recording.pairs)
    for number, record in list(folder.finished.items()):
        if number >= count:
            if folder.overwrite:
                folder.words.append(f"pair {number} is not in the recording any more; it is forgotten")
                del folder.finished[number]
                continue
            raise PlenoPIVError(
                f"{folder.directory}: holds {max(folder.finished) + 1} pairs, the recording {count}; "
                "use --overwrite, or another folder (output.directory, --out)"
            )
        changed = changed_frame(recording, record)
        if changed is None and not record.get("again"):
            if (pair_file(number) if count == 1 else "velocity.nc") in record["files"]:
                del folder.finished[number]  # it was one of several, and is alone now, or the other way
            continue
        if record["set_aside"] is None and not folder.overwrite:
            raise PlenoPIVError(
                f"{folder.directory}: holds a run of other frames ({changed}); use --overwrite, or another "
                "folder (output.directory, --out)"
            )
        was = "measured" if record["set_aside"] is None else "set aside"
        folder.words.append(f"pair {number} was {was} ({changed or record['set_aside']}); it is measured again")
        del folder.finished[number]
    tell_kept(folder, count)


def _tell_static_light(calibration: Mapping[str, Any]) -> None:
    if stated := calibration.get("static_light"):
        log.info(
            "static light: estimated from %d frames, to %.1f counts (RMS); it holds %.2f of the %.0f counts that "
            "particles give a pixel on the mean",
            *(stated[key] for key in ("frames", "error_counts", "particle_light_left_counts", "particle_light_counts")),
        )
