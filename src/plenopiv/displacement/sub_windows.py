"""Sub-window averaging: the vector of a window as the mean of the vectors of smaller windows within it.

By deformation, a window follows a displacement that is linear across it. Where the flow is curved within the window,
its particles disagree and bias the peak. Sub-windows follow the flow more closely but hold few particles each. The mean
of their vectors over the larger window has that window's resolution and number of particles, and less of the bias. The
mean is taken over a share of the window, since each sub-window is an average over its own extent already
(``resolution.averaged_share``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.settings import Sides
from plenopiv.displacement.windows import WindowGrid

WHOLE = (1.0, 1.0, 1.0)

Weights = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def mean_weights(windows: WindowGrid, sub_windows: WindowGrid, extrapolate: bool, share: Sides = WHOLE) -> Weights:
    """Weight of each sub-window in the mean over each window: (windows, sub-windows) along z, y, x.

    The mean over the middle ``share`` (along x, y, z) of a window of values that are linear between the centres of
    sub-windows. Beyond the outermost centres the values are extrapolated linearly if ``extrapolate``, else constant.
    """
    return tuple(  # type: ignore[return-value]
        _along(centres, offsets(size, part), knots, step, extrapolate)
        for centres, size, part, knots, step in zip(
            windows.centres, windows.size, share[::-1], sub_windows.centres, sub_windows.step, strict=True
        )
    )


def offsets(size: int, share: float) -> NDArray[np.float64]:
    """Places (size,) about the middle of a window of ``size`` voxels, evenly over a ``share`` of it: its voxels for
    1."""
    middle = 0.5 * (size - 1)
    return np.array([share * (n - middle) for n in range(size)], np.float64)


def _along(
    centres: NDArray[np.float64], off: NDArray[np.float64], knots: NDArray[np.float64], step: int, extrapolate: bool
) -> NDArray[np.float64]:
    """``mean_weights`` along one axis, over places ``off`` the windows' ``centres``."""
    size = off.size
    weights, last = np.zeros((centres.size, knots.size)), knots.size - 1
    if last == 0:
        return weights + 1.0
    place = (centres[:, None] + off - knots[0]) / step  # (windows, places), in steps of sub-windows
    if not extrapolate:
        place = np.clip(place, 0, last)
    before = np.clip(np.floor(place).astype(np.int64), 0, last - 1)
    after = place - before
    window = np.broadcast_to(np.arange(centres.size)[:, None], before.shape)
    np.add.at(weights, (window, before), (1 - after) / size)
    np.add.at(weights, (window, before + 1), after / size)
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
    share: Sides = WHOLE,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float32]]:
    """Displacement, raw displacement, valid and peak ratio of ``windows`` from those of ``sub_windows``, averaged over
    a ``share`` of each window.

    All four as in ``DisplacementField``. A window is valid where most of its weight is (``mostly_measured``); elsewhere
    its raw vector is the mean of the sub-windows' raw ones, outliers included. Of the peaks, the second over the first
    is averaged, with 1 where none was found, because the ratio itself has no upper limit.
    """
    linear, constant = (mean_weights(windows, sub_windows, extrapolate, share) for extrapolate in (True, False))
    measured = mostly_measured(valid, constant)
    mean = mean_over(displacement, linear)
    as_measured = np.where(measured, mean, mean_over(raw, linear))
    peaks = mean_over((peak_ratio > 0).astype(np.float64), constant) > 0
    second = mean_over(1 / np.maximum(peak_ratio, 1.0), constant)
    return mean, as_measured, measured, np.where(peaks, 1 / second, 0.0).astype(np.float32)
