"""What a user may choose about the reconstruction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from numbers import Integral, Real
from typing import TYPE_CHECKING, Literal, get_args

from plenopiv.errors import PlenoPIVError

if TYPE_CHECKING:
    from plenopiv.cameras.plenoptic import PlenopticCamera

Method = Literal["drt-mart", "mart", "mlos-mart"]
LightFieldMethod = Literal["drt-mart", "mart"]
Weights = Literal["1-ray", "9-rays", "exact"]
CandidateRule = Literal["bound", "product"]
MORE_OF_BLUR = 8.0  # times as many iterations, for a blur of a pitch
MANY_PIXELS, FEW_PIXELS = 14.0, 8.0  # of a microlens across: more need no more iterations; the fewest that were tried


@dataclass(frozen=True)
class ReconstructionSettings:
    """Method and parameters of one reconstruction.

    ``method``: which voxels MART starts from. "drt-mart": the candidates of dense ray tracing (plenoptic cameras);
    "mlos-mart": voxels that are lit along a line of sight of every camera (pinhole cameras); "mart": all that the
    cameras see.
    ``iterations``: over all views. ``relaxation``: exponent mu of each correction, 0 < mu <= 1, doubled in the first
    iteration of plenoptic cameras; fewer views are corrected at once where it is large, one at 1, which is slower.
    ``weights``: light by one centre ray per view, by nine, or by exact areas (plenoptic cameras).
    ``candidates``: the rule of dense ray tracing. "bound": voxels that can hold a particle of ``threshold`` counts
    without giving a pixel more light than it collected; "product", the paper's: voxels whose pixels all exceed
    ``threshold`` counts.
    ``threshold``: counts; of the bound, in a pixel that the particle lights wholly in focus. None: from the images, 0.2
    to 0.4 of the typical particle, or three times the noise (``candidates``).
    ``focus_reach``: half dead zones from focus within which light counts less in the correlation (``focus``); 0: none.
    ``seed``: of the random order of views. ``motion_tracking``: how often both frames of a pair are reconstructed again
    from a first guess that they share (``plenopiv.motion_tracking``).

    Raises ``PlenoPIVError`` for values out of range.
    """

    method: Method = "drt-mart"
    iterations: int = 5
    relaxation: float = 0.25
    weights: Weights = "exact"
    candidates: CandidateRule = "bound"
    threshold: float | None = None
    focus_reach: float = 2.0
    seed: int = 0
    motion_tracking: int = 0

    def __post_init__(self) -> None:
        for name, words in (("method", Method), ("weights", Weights), ("candidates", CandidateRule)):
            if (word := getattr(self, name)) not in get_args(words):
                allowed = " or ".join(f'"{each}"' for each in get_args(words))
                raise PlenoPIVError(f"reconstruction.{name}: {word!r} is not known; use {allowed}")
        for name, low, high in (("iterations", 1, inf), ("seed", 0, 2**63 - 1), ("motion_tracking", 0, 3)):
            n = getattr(self, name)
            whole = isinstance(n, Integral)
            if not (whole and low <= n <= high):
                upper = "" if high == inf else f" to {high}"
                raise PlenoPIVError(f"reconstruction.{name}: {n!r}; use a whole number from {low}{upper}")
        if not (isinstance(self.relaxation, Real) and 0 < self.relaxation <= 1):
            raise PlenoPIVError(f"reconstruction.relaxation: {self.relaxation!r}; use a number above 0, at most 1")
        for name, value in (("threshold", self.threshold or 0), ("focus_reach", self.focus_reach)):
            if not (isinstance(value, Real) and 0 <= value < inf):
                raise PlenoPIVError(f"reconstruction.{name}: {value!r}; use 0 or a positive number")

    def through(self, camera: PlenopticCamera) -> ReconstructionSettings:
        """The same with the iterations that a plenoptic camera takes. Light that its main lens spreads over microlenses
        is gathered again the slower: 1 + 8 times its blur in pitches as many. Fewer views tell particles apart the
        slower: below 14 pixels per microlens as many as views^-2, decision 68."""
        fewer = MANY_PIXELS / min(max(camera.pixels_per_microlens, FEW_PIXELS), MANY_PIXELS)
        more = (1 + round(MORE_OF_BLUR * camera.blur_mm / camera.lattice.pitch_mm)) * round(fewer**4)
        return replace(self, iterations=self.iterations * more)


TOMOGRAPHY = ReconstructionSettings(method="mlos-mart", relaxation=1.0)  # of pinhole cameras (Tomo-PIV)
