"""What a user may choose about the reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Method = Literal["drt-mart", "mart"]
Weights = Literal["1-ray", "9-rays", "exact"]


@dataclass(frozen=True)
class ReconstructionSettings:
    """Method and parameters of one reconstruction.

    ``method``: "drt-mart" starts from the voxels that dense ray tracing leaves, "mart" from all.
    ``iterations``: rounds over all views. ``relaxation``: exponent mu of each correction, 0 < mu <= 1.
    ``weights``: light by one centre ray per view, by nine, or by exact areas.
    ``threshold``: counts above which a pixel is lit; None lets the images' noise decide.
    ``tolerance_px``: pixels' worth of a voxel's light that may fall on unlit pixels before DRT drops it.
    ``focus_reach``: up to how many dead zones from focus planes count less in the correlation (``focus``); 0 = none.
    ``seed``: of the random order of views.
    """

    method: Method = "drt-mart"
    iterations: int = 5
    relaxation: float = 0.3
    weights: Weights = "exact"
    threshold: float | None = None
    tolerance_px: float = 3.0
    focus_reach: float = 1.5
    seed: int = 0
