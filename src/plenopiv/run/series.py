"""All frames of a recording: images -> volumes -> displacements -> velocity -> results folder.

Frames are ``dt_s`` apart; each is reconstructed once and correlated with the one before it.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.output import OutputFolder
from plenopiv.recording import Recording
from plenopiv.run import duration
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.judged import Judgement, judged, not_in_images
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import Frame, Progress, reconstructed, velocity_between
from plenopiv.run.plan import Plan, plan
from plenopiv.run.written import FirstFrame, Score, joined, summary_of, write_results, write_volume

if TYPE_CHECKING:
    import xarray

log = logging.getLogger("plenopiv")


@dataclass(frozen=True)
class RunResult:
    """The velocity field, what ``summary.json`` holds, and where both are."""

    velocity: xarray.Dataset
    summary: dict[str, Any]
    directory: Path


def run(
    experiment: Experiment,
    progress: Progress | None = None,
    overwrite: bool = False,
    score: Score | None = None,
    memory_gb: float | None = None,
    force: bool = False,
) -> RunResult:
    """Run the whole chain and write the results folder: velocity.nc, summary.json, experiment.toml, report.html
    and its figures.

    ``progress(stage, done, total)`` is called as work proceeds. ``score``, where the truth is known, turns the velocity
    field into measures for the report; a run itself never reads a truth. ``memory_gb``: a run that would take more is
    cut into tiles, or does not begin where these would not help. ``force``: a recording that the checks call unusable
    is measured all the same, and its field carries ``quality = "forced"``.

    Raises:
        PlenoPIVError: an input cannot be used, the recording is unusable, or memory does not suffice; the results
            folder is then as it was.
    """
    report = progress or (lambda stage, done, total: None)
    clock = Clock()
    with kept_warnings() as caught, OutputFolder(experiment.output_directory, overwrite) as out:
        for line in experiment.warnings():
            warnings.warn(line, PlenoPIVWarning, stacklevel=2)
        recording = experiment.recording()
        with clock("check"):
            judgement = judged(experiment, recording, force, report)
        with clock("calibration"):
            stage = partial(report, "static light of the frames")
            chain, recording, calibration = calibrated_chain(experiment, recording, judgement.check.lattice, stage)
        if stated := calibration.get("static_light"):
            log.info(
                "static light: estimated from %d frames, to %.1f counts (RMS); it holds %.2f of the %.0f counts that "
                "particles give a pixel on the mean",
                *(stated[key] for key in ("frames", "error_counts", "particle_light_left_counts")),
                stated["particle_light_counts"],
            )
        planned = plan(chain, memory_gb)
        log.info("memory: about %.2g GB", planned.needed.peak / 1e9)
        log.info("time: about %s", duration.as_text(planned.takes.run(len(recording), len(recording.pairs))))

        summaries, fields, first = dict[str, Any](), list["xarray.Dataset"](), None
        for number, before, after in _pairs(planned, recording, judgement, clock, report):
            for frame in (before, after):
                if frame.name not in summaries and experiment.output.volumes:
                    with clock("report"):
                        write_volume(out, frame)
                summaries[frame.name] = frame.summary()
            first = first or FirstFrame.of(planned.chain, before, clock)
            with clock("correlation"):
                time_s = recording.mid_time_s(number)
                field = velocity_between(planned.chain, before, after, recording.dt_s, time_s, report)
            if judgement.field_fits(recording, number, field):
                fields.append(field)
            del before, after, frame  # their volumes are not held while the next one is made
        if first is None or not fields:
            raise PlenoPIVError(f"no pair can be measured: {judgement.set_aside[0]['reason']}")
        velocity = joined(fields, experiment, judgement.quality)
        told = not_in_images(planned.chain, fields, recording.dt_s, recording.orientation)
        warned = [str(w.message) for w in caught]
        summary = {"not_in_images": told} | summary_of(
            experiment, velocity, summaries, calibration, judgement, planned, warned, clock
        )
        write_results(out, experiment, velocity, summary, first, score, clock)
    return RunResult(velocity, summary, experiment.output_directory)


def _pairs(
    planned: Plan, recording: Recording, judgement: Judgement, clock: Clock, report: Progress
) -> Iterator[tuple[int, Frame, Frame]]:
    """The pairs that can be measured, by number, each frame reconstructed once; after the first frame, what time is
    left."""
    held: dict[int, Frame] = {}
    lost: dict[int, str] = {}
    told = False
    for number, pair in enumerate(recording.pairs):
        held = {k: frame for k, frame in held.items() if k in pair}
        for k in pair:
            if k in held or lost.keys() & set(pair):
                continue
            try:
                with clock("reconstruction"):
                    held[k] = reconstructed(planned.chain, recording, k, report)
            except PlenoPIVError as error:
                lost[k] = str(error)
                continue
            if not told:
                told = True
                left = planned.takes.left(len(recording), clock.seconds["reconstruction"], len(recording.pairs))
                log.info("%s reconstructed; about %s left", held[k].name, duration.as_text(left))
        reason = next((lost[k] for k in pair if k in lost), None)
        if reason is not None:
            judgement.aside(recording, number, reason)
        elif judgement.pair_fits(recording, number, (held[pair[0]], held[pair[1]])):
            yield number, held[pair[0]], held[pair[1]]
