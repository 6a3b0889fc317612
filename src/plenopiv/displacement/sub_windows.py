"""Vectors of windows as means of those of smaller, inner windows.

One displacement and, by deformation, its neighbours' slopes are all that a window can follow; where a flow bends within
it, particles disagree and pull the peak. Smaller windows follow more closely, but hold few particles each: their mean
over the larger window has its resolution and its particles, and less of that error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.windows import WindowGrid

Weights = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def mean_weights(windows: WindowGrid, inner: WindowGrid, straight_on: bool) -> Weights:
    """What each inner window counts in the mean over each window: (windows, inner windows) along z, y, x.

    The mean over a window's voxels of values that are linear between the middles of inner windows; beyond the outermost
    ones ``straight_on`` or as they are there.
    """
    return tuple(  # type: ignore[return-value]
        _along(starts, size, knots, step, straight_on)
        for starts, size, knots, step in zip(windows.starts, windows.size, inner.centres, inner.step, strict=True)
    )


def _along(
    starts: NDArray[np.int64], size: int, knots: NDArray[np.float64], step: int, straight_on: bool
) -> NDArray[np.float64]:
    """``mean_weights`` along one axis."""
    weights, last = np.zeros((starts.size, knots.size)), knots.size - 1
    if last == 0:
        return weights + 1.0
    place = (starts[:, None] + np.arange(size) - knots[0]) / step  # (windows, voxels), in inner windows
    if not straight_on:
        place = np.clip(place, 0, last)
    before = np.clip(np.floor(place).astype(np.int64), 0, last - 1)
    share = place - before
    window = np.broadcast_to(np.arange(starts.size)[:, None], before.shape)
    np.add.at(weights, (window, before), (1 - share) / size)
    np.add.at(weights, (window, before + 1), share / size)
    return weights


def mean_over(values: NDArray, weights: Weights) -> NDArray[np.float64]:
    """Means (..., nz, ny, nx) over windows of ``values`` (..., mz, my, mx) of inner ones."""
    return np.einsum("zc,yb,xa,...cba->...zyx", *weights, values, optimize=True)


def measured_inside(valid: NDArray[np.bool_], held: Weights) -> NDArray[np.bool_]:
    """Windows (nz, ny, nx) of which more than half of the inside is measured."""
    return mean_over(valid.astype(np.float64), held) > 0.5


def averaged(
    displacement: NDArray[np.float64],
    raw: NDArray[np.float64],
    valid: NDArray[np.bool_],
    peak_ratio: NDArray[np.float32],
    inner: WindowGrid,
    windows: WindowGrid,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float32]]:
    """The same four of ``windows``, of those of ``inner`` ones, all as ``DisplacementField`` has them.

    A window is measured where more than half of what is inside it is; elsewhere its raw vector is the mean of inner
    ones as they were measured, outliers among them. What is averaged of peaks is the second one's share of the first,
    1 where none was found: a ratio has no limit.
    """
    straight, held = (mean_weights(windows, inner, straight_on) for straight_on in (True, False))
    measured = measured_inside(valid, held)
    mean = mean_over(displacement, straight)
    as_measured = np.where(measured, mean, mean_over(raw, straight))
    peaks = mean_over((peak_ratio > 0).astype(np.float64), held) > 0
    second = mean_over(1 / np.maximum(peak_ratio, 1.0), held)
    return mean, as_measured, measured, np.where(peaks, 1 / second, 0.0).astype(np.float32)
