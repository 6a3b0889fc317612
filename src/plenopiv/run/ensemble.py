"""Many pairs' kept volumes as one field each: all pairs of a steady flow, or those of each phase."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.displacement.ensemble import PLANES_BYTES
from plenopiv.errors import PlenoPIVError
from plenopiv.recording import Recording
from plenopiv.run.frame import Progress
from plenopiv.run.kept import KeptVolumes
from plenopiv.run.log import Clock
from plenopiv.run.pair import Job, PairRecord
from plenopiv.run.plan import Plan
from plenopiv.run.shown import VolumeShown
from plenopiv.statistics import Phases
from plenopiv.statistics.phase import PERIOD
from plenopiv.volume import SparseVolume

if TYPE_CHECKING:
    import xarray

MORE = 1.07  # of the time of a pair's own correlation
SWEEPS = 8  # times that a pair is read, with the default passes


@dataclass(frozen=True)
class KeptPairs:
    """Pairs of volumes of a recording by their numbers, read whenever they are asked for."""

    kept: KeptVolumes
    recording: Recording
    numbers: Sequence[int]

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, index: int) -> tuple[SparseVolume, SparseVolume]:
        first, second = self.recording.pairs[self.numbers[index]]
        return self.kept.volume(self.recording, first), self.kept.volume(self.recording, second)


@dataclass(frozen=True)
class Ensembles:
    """Fields of pairs together: ``pairs`` of each by their numbers. ``phase``: the middle of each bin, in the unit of
    ``period``; empty without phases. ``left_out``: pairs that were set aside for their frames, or have no phase."""

    kept: KeptVolumes
    pairs: tuple[tuple[int, ...], ...]
    left_out: int
    phase: tuple[float, ...] = ()
    period: float = PERIOD

    @classmethod
    def of(cls, kept: KeptVolumes, phases: Phases | None = None, bins: int = 1) -> Ensembles:
        """All pairs as one, or ``bins`` of them by ``phases``.

        Raises:
            PlenoPIVError: ``phases`` name a pair that there is not, or no pair is in a bin.
        """
        usable, count = kept.measurable, len(kept.manifest.pairs)
        if not usable:
            raise PlenoPIVError(f"{kept.results}: all pairs were set aside for their frames")
        if phases is None:
            return cls(kept, (tuple(usable),), count - len(usable))
        phases.check(count)
        bin_of, step = phases.bins_of(bins), phases.period / bins
        pairs = tuple(tuple(number for number in usable if bin_of.get(number) == k) for k in range(bins))
        for k, numbers in enumerate(pairs):
            if not numbers:
                filled = sum(map(bool, pairs))
                raise PlenoPIVError(
                    f"{phases.source}: no pair that was measured has a phase of {k * step:g} +- {step / 2:g}; use "
                    f"fewer bins than {bins}, of which {filled} are filled"
                )
        return cls(kept, pairs, count - sum(map(len, pairs)), tuple(k * step for k in range(bins)), phases.period)

    @property
    def words(self) -> list[str]:
        """For the name of the results folder."""
        return [f"{len(self.phase)}-phases"] if self.phase else ["ensemble"]

    @property
    def stated(self) -> dict[str, Any]:
        """What the fields depend on, beside volumes and settings."""
        return {"ensemble": {"pairs": [list(each) for each in self.pairs], "phase": list(self.phase)}}

    @property
    def summary(self) -> dict[str, Any]:
        """How many pairs each field is of, and how many were left out."""
        pairs = [len(each) for each in self.pairs]
        found = {"pairs": pairs, "pairs_left_out": self.left_out}
        stated = found | ({"phase": list(self.phase)} if self.phase else {})
        return {"pairs": sum(pairs), "ensemble": stated}

    def times(self, recording: Recording) -> dict[str, list[float]]:
        """Mean times, numbers of pairs, and phases."""
        times: dict[str, list[float]] = {
            "time": [float(np.mean([recording.mid_time_s(number) for number in each])) for each in self.pairs],
            "pairs": [len(each) for each in self.pairs],
        }
        return times | ({"phase": list(self.phase)} if self.phase else {})

    def plan(self, each: Plan) -> Plan:
        """What a field takes, of what a pair does."""
        many = sum(map(len, self.pairs)) / len(self.pairs)
        takes = replace(each.takes, frame=SWEEPS * many * each.takes.frame, pair=MORE * many * each.takes.pair)
        return replace(each, needed=replace(each.needed, layers=each.needed.layers + PLANES_BYTES), takes=takes)

    def measured(
        self, job: Job, numbers: Sequence[int], clock: Clock, report: Progress, shown: VolumeShown
    ) -> Iterator[PairRecord]:
        """The records of the fields ``numbers``, in their order, the fields written."""
        for number in numbers:
            with clock("correlation"):
                yield self._measured(job, number, report)

    def _measured(self, job: Job, number: int, report: Progress) -> PairRecord:
        many = len(self.pairs[number])
        names = (f"the first frames of {many} pair{'s'[: many > 1]}", "the second ones")
        return job.completed(self._record(number), partial(self._field, job, number, report), names, len(self.pairs))

    def _record(self, number: int) -> PairRecord:
        """What the run found out about the frames: of each kind of finding the first."""
        found = [self.kept.record(pair) for pair in self.pairs[number]]
        findings = {finding["name"]: finding for record in reversed(found) for finding in reversed(record.findings)}
        warned = dict.fromkeys(words for record in found for words in record.warnings)
        summaries = {name: summary for record in found for name, summary in record.summaries.items()}
        return PairRecord(number, [], findings=list(findings.values()), warnings=list(warned), summaries=summaries)

    def _field(self, job: Job, number: int, report: Progress) -> xarray.Dataset:
        recording, chain = job.recording, job.chain
        pairs = KeptPairs(self.kept, recording, self.pairs[number])
        time_s = self.times(recording)["time"][number]
        field = chain.ensemble(pairs, recording.dt_s, time_s, report)
        field["time"].attrs["long_name"] = f"mean over the pairs of: {recording.time_meaning}"
        field.attrs["title"] += ", ensemble correlation"
        field["pairs"] = "time", np.array([len(pairs)], np.int32), {"long_name": "number of pairs", "units": "1"}
        if self.phase:
            unit = "degree" if self.period == PERIOD else "1"
            words = f"bins are {self.period / len(self.phase):g} wide, the period is {self.period:g}"
            about = {"units": unit, "long_name": "phase, middle of the bin", "comment": words}
            field["phase"] = "time", [float(self.phase[number])], about
        return field
