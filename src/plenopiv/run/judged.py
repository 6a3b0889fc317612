"""What the checks say of a recording before it is measured, and of each pair as it comes.

A fault of the whole recording is refused; one of a pair sets that pair aside; what is doubtful is a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from plenopiv.calibration import LatticeFit
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.checks import CheckResult, Finding, PairCheck, check, common, explained
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.experiment import Experiment
from plenopiv.recording import Recording
from plenopiv.run.frame import Progress
from plenopiv.run.space import grid_of

if TYPE_CHECKING:
    import xarray

OF_FRAMES = {"underexposed", "overexposed", "flipped", "other-camera", "same-frame", "partly-dark"}
FORCE = "--force (force=True in Python) goes on all the same"


class Judged(Protocol):
    """A frame that is judged with the other one of its pair."""

    @property
    def name(self) -> str:
        """As messages have it."""

    @property
    def image(self) -> NDArray:
        """Upright, in counts, without static light."""

    @property
    def unexplained(self) -> float | None:
        """Share of its light that the volume does not explain; None where that is not known."""


@dataclass(frozen=True)
class PairJudge:
    """What judges every pair as it comes; plain data. ``known``: severities of what was found in the whole recording;
    ``forced``: what is unusable is measured all the same."""

    forced: bool
    check: PairCheck
    known: tuple[str, ...] = ()

    def of_images(self, before: Judged, after: Judged) -> tuple[list[Finding], str | None]:
        """Findings that are not good on the frames of a pair, and why it cannot be measured, if so."""
        names = (printable(before.name), printable(after.name))
        found: list[Finding] = []
        for finding in self.check.findings((before.image, after.image), names):
            if finding.severity == "unusable" and not self.forced:
                return found, f"{finding.words}; {finding.advice}"
            found.append(finding)
        for frame, name in zip((before, after), names, strict=True):
            if left := explained.finding(frame.unexplained, name):
                found.append(left)
        return found, None

    def of_field(self, velocity: xarray.Dataset, names: tuple[str, str]) -> tuple[list[Finding], str | None]:
        """The same of the field between the frames ``names``: whether they have anything in common."""
        found = common.finding(velocity, [printable(name) for name in names])
        if found is None:
            return [], None
        if found.severity == "unusable" and not self.forced:
            return [], f"{found.words}; {found.advice}"
        return [found], None

    def quality(self, findings: Sequence[Mapping[str, Any]] = (), set_aside: bool = False) -> str:
        """ "good"; "doubtful" with warnings or pairs set aside; "forced" where a run went on against a refusal."""
        severities = {*self.known, *(finding["severity"] for finding in findings)}
        if "unusable" in severities:
            return "forced"
        return "doubtful" if severities or set_aside else "good"


@dataclass(frozen=True)
class Judgement:
    """What the checks say of a whole recording, and what judges its pairs. ``findings``: those that are not good.
    ``lattice``: of the white image, where one was looked for and found."""

    pairs: PairJudge
    findings: list[Finding]
    lattice: LatticeFit | None = None

    def summary(self, records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """What ``summary.json`` holds of it; ``records`` of all pairs (``PairRecord``). Of each kind of finding the
        first is kept."""
        findings = {finding.name: asdict(finding) for finding in reversed(self.findings)}
        findings = dict(reversed(findings.items()))
        for record in records:
            for finding in record["findings"]:
                findings.setdefault(finding["name"], finding)
        aside = [
            {
                "pair": record["pair"],
                "frames": [entry["name"] for entry in record["frames"]],
                "reason": record["set_aside"],
            }
            for record in records
            if record["set_aside"] is not None
        ]
        quality = self.pairs.quality(list(findings.values()), bool(aside))
        return {"quality": quality, "set_aside": aside, "findings": list(findings.values())}


def warnings_of(record: Mapping[str, Any]) -> list[str]:
    """What is to be warned of in a pair: what was said while it was measured, findings, and why it was set aside."""
    said = [*record["warnings"], *record["field_warnings"], *(line_of(finding) for finding in record["findings"])]
    if record["set_aside"] is not None:
        which = " and ".join(printable(entry["name"]) for entry in record["frames"])
        said.append(f"{f'the pair {which}' if which else 'an ensemble'} is set aside: {record['set_aside']}")
    return said


class Told:
    """Warnings of pairs, each once, and of each kind of finding the first alone."""

    def __init__(self, findings: Sequence[Finding], said: Sequence[str]) -> None:
        self.names, self.said = {finding.name for finding in findings}, list(said)

    def add(self, record: Mapping[str, Any]) -> list[str]:
        """What is new in a pair."""
        new = [finding for finding in record["findings"] if finding["name"] not in self.names]
        first = list({finding["name"]: finding for finding in reversed(new)}.values())[::-1]
        self.names |= {finding["name"] for finding in first}
        lines = [one for one in warnings_of({**record, "findings": first}) if one not in self.said]
        self.said += lines
        return lines


def judged(
    experiment: Experiment, recording: Recording, force: bool, progress: Progress, space: SpaceMap | None = None
) -> Judgement:
    """Check a recording before it is measured. ``space``: as ``space_of`` gives it.

    Raises:
        PlenoPIVError: it is unusable and the run is not forced, or no image can be read.
    """
    settings = (experiment.camera(), grid_of(experiment, space), experiment.correlation.settings())
    look = partial(
        check,
        progress=partial(_stage, progress),
        with_motion=False,
        stated=experiment.calibration is None,
        blur_measured=experiment.blur_measured,
        drift_measured=experiment.drift_measured,
    )
    found = look(recording, *settings)
    bad = _unusable(found)
    if len(recording.pairs) > 1 and {finding.name for finding in bad} & OF_FRAMES:
        other = look(_from_the_middle(recording), *settings)
        if not {finding.name for finding in _unusable(other)} & OF_FRAMES:  # one pair is bad: set aside when it comes
            found, bad = other, _unusable(other)
    possible = found.lattice is not None or recording.white_source is None
    if bad and not (force and possible):
        more = "".join(f"; {finding.words}" for finding in bad[1:])
        raise PlenoPIVError(f"{bad[0].words}: {bad[0].advice}{more}{f'; {FORCE}' if possible else ''}")
    pairs = PairCheck(recording.sensor, found.white_now, found.camera, recording.unusable)
    findings = list({finding.name: finding for finding in reversed(found.findings)}.values())[::-1]
    findings = [finding for finding in findings if finding.severity != "good"]
    for finding in findings:
        warnings.warn(line_of(asdict(finding)), PlenoPIVWarning, stacklevel=3)
    judge = PairJudge(force, pairs, tuple(finding.severity for finding in findings))
    return Judgement(judge, findings, found.lattice)


def _unusable(found: CheckResult) -> list[Finding]:
    return [finding for finding in found.findings if finding.severity == "unusable"]


def _from_the_middle(recording: Recording) -> Recording:
    """The second half of a recording."""
    other, middle = copy(recording), len(recording.pairs) // 2
    if recording.is_sequence:
        damaged = {k - middle: why for k, why in recording.damaged.items() if k >= middle}
        count = len(recording) - middle
        pairs = tuple((k, k + 1) for k in range(count - 1))
        other.__dict__.update(frames=recording.frames[middle:], pairs=pairs, damaged=damaged)
    else:
        other.__dict__["pairs"] = recording.pairs[middle:]
    return other


def _stage(progress: Progress, stage: str, done: int, total: int) -> None:
    progress(f"check: {stage}", done, total)


def line_of(finding: Mapping[str, Any]) -> str:
    """A finding, as a dict, in one line."""
    return f"{finding['words']}; {finding['advice']}" if finding["advice"] else str(finding["words"])
