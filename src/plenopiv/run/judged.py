"""What the checks say of a recording before it is measured, and of each pair as it comes.

A fault of the whole recording is refused; one of a pair sets that pair aside; what is doubtful is a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from copy import copy
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.chain import Chain
from plenopiv.checks import CheckResult, Finding, PairCheck, check, common, explained
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning, printable
from plenopiv.experiment import Experiment
from plenopiv.recording import Recording
from plenopiv.run.pair import Frame, Progress

if TYPE_CHECKING:
    import xarray

OF_FRAMES = {"underexposed", "overexposed", "flipped", "other-camera", "same-frame", "partly-dark"}
FORCE = "--force (force=True in Python) goes on all the same"


@dataclass
class Judgement:
    """Findings that are not good, and pairs that were set aside: their number from 0, frames and reason."""

    forced: bool
    check: CheckResult
    pair_check: PairCheck
    findings: list[Finding] = field(default_factory=list)
    set_aside: list[dict[str, Any]] = field(default_factory=list)

    @property
    def quality(self) -> str:
        """ "good"; "doubtful" with warnings or pairs set aside; "forced" where a run went on against a refusal."""
        if any(finding.severity == "unusable" for finding in self.findings):
            return "forced"
        return "doubtful" if self.findings or self.set_aside else "good"

    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` holds of it."""
        findings = [asdict(finding) for finding in self.findings]
        return {"quality": self.quality, "set_aside": list(self.set_aside), "findings": findings}

    def pair_fits(self, recording: Recording, number: int, frames: tuple[Frame, Frame]) -> bool:
        """Whether a pair can be measured; if not it is set aside."""
        a, b = (recording.pairs[number][0], recording.pairs[number][1])
        names = (printable(recording.frames[a].name), printable(recording.frames[b].name))
        for finding in self.pair_check.findings((frames[0].image, frames[1].image), names):
            if finding.severity == "unusable" and not self.forced:
                self.aside(recording, number, f"{finding.words}; {finding.advice}")
                return False
            self._note(finding)
        for frame, name in zip(frames, names, strict=True):
            if left := explained.finding(frame.unexplained, name):
                self._note(left)
        return True

    def field_fits(self, recording: Recording, number: int, velocity: xarray.Dataset) -> bool:
        """Whether the field of a pair is one; if its frames have nothing in common the pair is set aside."""
        found = common.finding(velocity, [printable(recording.frames[k].name) for k in recording.pairs[number]])
        if found is None:
            return True
        if found.severity == "unusable" and not self.forced:
            self.aside(recording, number, f"{found.words}; {found.advice}")
            return False
        self._note(found)
        return True

    def aside(self, recording: Recording, number: int, reason: str) -> None:
        """Set a pair aside."""
        names = [recording.frames[k].name for k in recording.pairs[number]]
        self.set_aside.append({"pair": number, "frames": names, "reason": reason})
        which = " and ".join(printable(name) for name in names)
        warnings.warn(f"the pair {which} is set aside: {reason}", PlenoPIVWarning, stacklevel=3)

    def _note(self, finding: Finding) -> None:
        """Keep and show a finding, one of each name."""
        if finding.name not in [known.name for known in self.findings]:
            self.findings.append(finding)
            warnings.warn(_line(finding), PlenoPIVWarning, stacklevel=3)


def judged(experiment: Experiment, recording: Recording, force: bool, progress: Progress) -> Judgement:
    """Check a recording before it is measured.

    Raises:
        PlenoPIVError: it is unusable and the run is not forced, or no image can be read.
    """
    settings = (experiment.camera(), experiment.grid(), experiment.correlation.settings())
    found = check(recording, *settings, partial(_stage, progress), with_motion=False)
    bad = _unusable(found)
    if len(recording.pairs) > 1 and {finding.name for finding in bad} & OF_FRAMES:
        other = check(_from_the_middle(recording), *settings, partial(_stage, progress), with_motion=False)
        if not {finding.name for finding in _unusable(other)} & OF_FRAMES:  # one pair is bad: set aside when it comes
            found, bad = other, _unusable(other)
    possible = found.lattice is not None or recording.white_source is None
    if bad and not (force and possible):
        more = "".join(f"; {finding.words}" for finding in bad[1:])
        raise PlenoPIVError(f"{bad[0].words}: {bad[0].advice}{more}{f'; {FORCE}' if possible else ''}")
    pairs = PairCheck(recording.sensor, found.white, found.camera.image_pitch_px, recording.unusable)
    judgement = Judgement(force, found, pairs)
    for finding in found.findings:
        if finding.severity != "good":
            judgement._note(finding)
    return judgement


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


def _line(finding: Finding) -> str:
    return f"{finding.words}; {finding.advice}" if finding.advice else finding.words


def not_in_images(chain: Chain, fields: Sequence[Any], dt_s: float, orientation: str) -> dict[str, Any]:
    """What no image can tell, to be compared with what is known of the experiment: the largest displacement (voxels
    along x, y, z) and velocity (m/s), the time between pulses and the orientation that both rest on."""
    largest = {name: max(float(np.nanmax(np.abs(one[name].values))) for one in fields) for name in "uvw"}
    voxels = [1e3 * dt_s * largest[name] / d for name, d in zip("uvw", chain.grid.voxel_mm, strict=True)]
    speed = max(float(np.nanmax(np.sqrt(one.u**2 + one.v**2 + one.w**2).values)) for one in fields)
    return {
        "largest_displacement_voxels": voxels,
        "largest_velocity_m_s": speed,
        "dt_s": dt_s,
        "orientation": orientation,
    }
