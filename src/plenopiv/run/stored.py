"""Pairs of a series stored as they come, and put together when all are there: what every way to measure them shares."""

from __future__ import annotations

import json
import logging
import shutil
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run.frame import Progress
from plenopiv.run.judged import Judgement, Told
from plenopiv.run.log import Clock
from plenopiv.run.pair import PairRecord
from plenopiv.run.plan import Plan
from plenopiv.run.shown import FirstFrame
from plenopiv.run.written import Record, Score, summary_of, write_results

log = logging.getLogger("plenopiv")
BYTES_A_VECTOR = 80.0  # of a field, at most
BYTES_OF_GRADIENTS = 224.0  # more, of a vector: 14 derivatives with their standard deviations
BYTES_A_VOXEL = 5.0  # kept, of a volume's file
LEAST_KEPT = 0.01  # share of the voxels that a volume keeps


@dataclass
class StoredSeries:
    """The fields of a recording in their results folder, which has been settled with ``inputs``. ``times``: "time" of
    each field in s, and variables that the fields have of each time. ``calibration``: as summary.json has it.
    ``warned``: what was warned of before."""

    folder: SeriesFolder
    experiment: Experiment
    recording: Recording
    times: Mapping[str, Sequence[float]]
    inputs: Mapping[str, Any]
    judgement: Judgement
    calibration: Mapping[str, Any]
    planned: Plan
    clock: Clock
    report: Progress
    warned: Sequence[str] = ()

    @property
    def count(self) -> int:
        """How many fields there are to be."""
        return len(self.times["time"])

    def store(self, records: Iterable[PairRecord], count: int) -> None:
        """Keep the records of ``count`` pairs as they come, and tell what is new in them.

        Raises:
            PlenoPIVError: the folder cannot be written; as ``records`` do. What was kept before stays.
        """
        told = Told(self.judgement.findings, self.warned)
        keep_as_they_come(self.folder, records, told, count, self.count, self.report)

    def put_together(
        self,
        first: Callable[[Sequence[Record], Progress], FirstFrame],
        score: Score | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Make the results of all pairs' records, and move them into place; returns the summary, with ``more`` in it.
        ``first``: makes what the report shows of the first frame.

        Raises:
            PlenoPIVError: no pair could be measured, or a file cannot be written.
        """
        folder = self.folder
        records = [folder.finished[number] for number in range(self.count)]
        if all(record["set_aside"] is not None for record in records):
            folder.discard()
            raise PlenoPIVError(f"no pair can be measured: {records[0]['set_aside']}")
        folder.check_whole()
        told = Told(self.judgement.findings, self.warned)
        for entry in records:
            told.add(entry)
        summary = summary_of(
            self.experiment,
            self.recording,
            records,
            self.calibration,
            self.judgement,
            self.planned,
            told.said,
            self.clock,
        )
        summary |= {"inputs_sha256": folder.depends} | dict(more or {})
        shown = first(records, self.report)
        files = write_results(folder, self.experiment, self.times, records, summary, shown, score, self.clock)
        folder.publish(files, self.inputs)
        return summary


def keep_as_they_come(
    folder: SeriesFolder, records: Iterable[PairRecord], told: Told, left: int, count: int, report: Progress
) -> None:
    """Keep the records of ``left`` pairs, of ``count`` in all, as they come, and tell what is new in them.

    Raises:
        PlenoPIVError: the folder cannot be written; as ``records`` do. What was kept before stays.
    """
    if left > 1:
        report("pairs", 0, left)
    try:
        for done, record in enumerate(records, 1):
            kept = folder.store(record.content(), record.files)
            for said in told.add(kept):
                warnings.warn(said, PlenoPIVWarning, stacklevel=3)
            if left > 1:
                report("pairs", done, left)
    except BaseException:
        if folder.finished and folder.is_mine:
            done = len(folder.finished)
            log.info("%d of %d pairs are finished and kept; the same command goes on from there", done, count)
        raise


def summary_there(folder: SeriesFolder) -> dict[str, Any]:
    """The summary of results that are complete, where nothing has changed and nothing is to be done."""
    log.info("%s: complete, and nothing has changed; nothing to do", folder.directory)
    folder.discard()
    found: dict[str, Any] = json.loads((folder.directory / "summary.json").read_text(encoding="utf-8"))
    return found


def times_of(recording: Recording) -> dict[str, list[float]]:
    """Of the fields of all pairs."""
    return {"time": [recording.mid_time_s(number) for number in range(len(recording.pairs))]}


def tell_kept(folder: SeriesFolder, count: int) -> None:
    """Say what was found damaged, and how many pairs are kept."""
    for words in folder.words:
        log.info("%s", words)
    if folder.finished:
        log.info("%d of %d pairs are finished and whole: they are kept", len(folder.finished), count)


def tell_plan(planned: Plan, frames: int, pairs: int, memory: str | None = None) -> None:
    """Say what memory and time so many frames and pairs take; ``memory`` in words where several processes share it."""
    log.info("memory: %s", memory or f"about {planned.needed.peak / 1e9:.2g} GB")
    if (device := planned.chain.device).kind != "cpu":
        log.info("device: %s; about %.2g GB of its memory", device.text, planned.on_device / 1e9)
    log.info("time: %s", planned.takes.words(frames, pairs))


def ask_for_space(
    folder: SeriesFolder, planned: Plan, pairs: int, count: int, gradients: bool = False, volumes: int = 0
) -> None:
    """Compare the space on disk with what is to be written: the files of ``pairs``, velocity.nc, which has all
    ``count`` once more where there are several, and at least so many ``volumes``. ``gradients``: are in them.

    Raises:
        PlenoPIVError: it does not suffice; there are to be gradients, and one layer of vectors.
    """
    grid, correlation = planned.chain.grid, planned.chain.correlation
    shape = window_grid(grid.shape, correlation.windows[-1], correlation.overlap).shape
    if gradients and min(shape) < 2:
        raise PlenoPIVError(
            f"output.gradients: vectors are {' x '.join(map(str, shape[::-1]))} along x, y, z, and a derivative "
            "takes two along each; take smaller windows or a larger volume, or leave output.gradients out"
        )
    fields = pairs + (count if count > 1 else 0)
    needed = fields * prod(shape) * (BYTES_A_VECTOR + BYTES_OF_GRADIENTS * gradients)
    needed += volumes * BYTES_A_VOXEL * LEAST_KEPT * planned.chain.lens_grid.size
    free = shutil.disk_usage(folder.work).free
    if needed > free:
        raise PlenoPIVError(
            f"{folder.directory}: its disk has {free / 1e9:.2g} GB left, fields of {count} pair{'s'[: count > 1]} take "
            f"about {needed / 1e9:.2g} GB more; make room, or take another output.directory"
        )
