"""What all checks of a recording found."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration import LatticeFit
from plenopiv.calibration.drift import DriftFit
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks import fit, light, motion
from plenopiv.checks.findings import Finding


@dataclass(frozen=True)
class CheckResult:
    """Findings on a recording, and what was measured for them.

    ``frame`` and ``white`` are upright counts; ``camera`` has the ``lattice`` of the white image, where one was found,
    moved by ``drift`` where frames show one;
    ``fit``, ``light`` and ``motion`` are None where an earlier finding leaves nothing to measure.
    """

    findings: tuple[Finding, ...]
    camera: PlenopticCamera
    name: str
    frame: NDArray[np.uint16]
    white: NDArray[np.uint16] | None
    lattice: LatticeFit | None = None
    fit: fit.Fit | None = None
    light: light.Light | None = None
    motion: motion.Motion | None = None
    drift: DriftFit | None = None

    @property
    def white_now(self) -> NDArray | None:
        """The white image as it would be now, where the array has drifted."""
        return self.white if self.white is None or self.drift is None else self.drift.drift.moved(self.white)

    def __repr__(self) -> str:
        counts = Counter(finding.severity for finding in self.findings)
        said = ", ".join(f"{number} {severity}" for severity, number in counts.items())
        return f"<CheckResult of {self.name}: {said}>"

    @property
    def usable(self) -> bool:
        """Whether no finding is "unusable"."""
        return all(finding.severity != "unusable" for finding in self.findings)
