"""What a user may choose about the reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Method = Literal["drt-mart", "mart"]
Weights = Literal["1-ray", "9-rays", "exact"]
Candidates = Literal["bound", "product"]


@dataclass(frozen=True)
class ReconstructionSettings:
    """Method and parameters of one reconstruction.

    ``method``: "drt-mart" starts from the voxels that dense ray tracing leaves, "mart" from all.
    ``iterations``: rounds over all views. ``relaxation``: exponent mu of each correction, 0 < mu <= 1, doubled in the
    first round; fewer views are corrected at once where it is large, one at 1, which is slower.
    ``weights``: light by one centre ray per view, by nine, or by exact areas.
    ``candidates``: what DRT leaves. "bound": voxels that can hold a particle of ``threshold`` counts without giving a
    pixel more light than it collected; "product", the paper's: voxels whose pixels all exceed ``threshold`` counts.
    ``threshold``: counts; of the bound, in a pixel that the particle lights wholly in focus. None lets the images
    decide: 0.2 to 0.4 of the typical particle, or three times the noise.
    ``focus_reach``: up to how many dead zones from focus planes count less in the correlation (``focus``); 0 = none.
    ``seed``: of the random order of views.
    """

    method: Method = "drt-mart"
    iterations: int = 5
    relaxation: float = 0.25
    weights: Weights = "exact"
    candidates: Candidates = "bound"
    threshold: float | None = None
    focus_reach: float = 1.5
    seed: int = 0


@dataclass(frozen=True)
class TomographySettings:
    """Parameters of one reconstruction from several pinhole cameras (Tomo-PIV).

    ``iterations``: rounds over all cameras. ``relaxation``: exponent mu of each correction, 0 < mu <= 1. ``threshold``:
    counts above which a line of sight is lit; None lets the images decide (``tomography.lit_above``).
    ``seed``: of the random order of cameras.
    """

    iterations: int = 5
    relaxation: float = 1.0
    threshold: float | None = None
    seed: int = 0
