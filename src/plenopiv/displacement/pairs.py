"""What the passes of multi-grid correlation ask of volumes: of one pair, of many, or of a pair on a device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import PassResult, StepDone
from plenopiv.displacement.windows import WindowGrid

Progress = Callable[[str, int, int], None]


class Pairs(Protocol):
    """What the passes correlate: one pair of volumes, or many whose correlations are summed."""

    def correlated(
        self,
        windows: WindowGrid,
        predictor: SplineField | None,
        settings: CorrelationSettings,
        search: float,
        step_done: StepDone | None = None,
        scatter: bool = False,
    ) -> PassResult:
        """As ``correlation_pass``."""

    def offset(
        self, windows: WindowGrid, first: NDArray[np.float64], progress: Progress | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """As ``discrete_offset``."""
