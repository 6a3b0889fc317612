"""Sub-window averaging: the vector of a window as the mean of the vectors of smaller windows within it.

By deformation, a window follows a displacement that is linear across it. Where the flow is curved within the window,
its particles disagree and bias the peak. Sub-windows follow the flow more closely but hold few particles each. The mean
of their vectors over the larger window has that window's resolution and number of particles, and less of the bias.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.windows import WindowGrid

Weights = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def mean_weights(windows: WindowGrid, sub_windows: WindowGrid, extrapolate: bool) -> Weights:
    """Weight of each sub-window in the mean over each window: (windows, sub-windows) along z, y, x.

    The mean over a window's voxels of values that are linear between the centres of sub-windows. Beyond the outermost
    centres the values are extrapolated linearly if ``extrapolate``, else constant.
    """
    return tuple(  # type: ignore[return-value]
        _along(starts, size, knots, step, extrapolate)
        for starts, size, knots, step in zip(
            windows.starts, windows.size, sub_windows.centres, sub_windows.step, strict=True
        )
    )


def _along(
    starts: NDArray[np.int64], size: int, knots: NDArray[np.float64], step: int, extrapolate: bool
) -> NDArray[np.float64]:
    """``mean_weights`` along one axis."""
    weights, last = np.zeros((starts.size, knots.size)), knots.size - 1
    if last == 0:
        return weights + 1.0
    place = (starts[:, None] + np.arange(size) - knots[0]) / step  # (windows, voxels), in steps of sub-windows
    if not extrapolate:
        place = np.clip(place, 0, last)
    before = np.clip(np.floor(place).astype(np.int64), 0, last - 1)
    share = place - before
    window = np.broadcast_to(np.arange(starts.size)[:, None], before.shape)
    np.add.at(weights, (window, before), (1 - share) / size)
    np.add.at(weights, (window, before + 1), share / size)
    return weights


def mean_over(values: NDArray, weights: Weights) -> NDArray[np.float64]:
    """Means (..., nz, ny, nx) over windows of ``values`` (..., mz, my, mx) of sub-windows."""
    z, y, x = weights
    along_x = np.einsum("xa,...cba->...cbx", x, values)  # axis by axis, without BLAS: its threads change the last bits
    return np.einsum("zc,...cyx->...zyx", z, np.einsum("yb,...cbx->...cyx", y, along_x))


def mostly_measured(valid: NDArray[np.bool_], weights: Weights) -> NDArray[np.bool_]:
    """Windows (nz, ny, nx) in whose mean the ``valid`` sub-windows (mz, my, mx) have more than half of the weight."""
    return mean_over(valid.astype(np.float64), weights) > 0.5


def average_sub_windows(
    displacement: NDArray[np.float64],
    raw: NDArray[np.float64],
    valid: NDArray[np.bool_],
    peak_ratio: NDArray[np.float32],
    sub_windows: WindowGrid,
    windows: WindowGrid,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float32]]:
    """Displacement, raw displacement, valid and peak ratio of ``windows`` from those of ``sub_windows``.

    All four as in ``DisplacementField``. A window is valid where most of its weight is (``mostly_measured``); elsewhere
    its raw vector is the mean of the sub-windows' raw ones, outliers included. Of the peaks, the second over the first
    is averaged, with 1 where none was found, because the ratio itself has no upper limit.
    """
    linear, constant = (mean_weights(windows, sub_windows, extrapolate) for extrapolate in (True, False))
    measured = mostly_measured(valid, constant)
    mean = mean_over(displacement, linear)
    as_measured = np.where(measured, mean, mean_over(raw, linear))
    peaks = mean_over((peak_ratio > 0).astype(np.float64), constant) > 0
    second = mean_over(1 / np.maximum(peak_ratio, 1.0), constant)
    return mean, as_measured, measured, np.where(peaks, 1 / second, 0.0).astype(np.float32)
