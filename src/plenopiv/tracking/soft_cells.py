"""Cells of microlenses where the main lens blurs: how much of the light that is meant for a place arrives in a cell.

A main lens that is not sharp displaces a ray on the microlens plane by a Gaussian, its direction kept. Of the rays that
a sharp lens would send to a place a microlens then has a share: its cell, convolved with that Gaussian, at the place.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

REACH = 3.5  # standard deviations beyond a cell after which its share is cut off, at 2e-4
STEPS = 12  # of the table in a standard deviation: linear interpolation is right to 2e-4
FINEST = 1 / 600  # pitches between entries of the table
LEAST = 0.02  # pitches: a blur below that is none
WITHIN = 16  # lines in each step along t, on which a cell's outline is taken

Array = NDArray[np.float64]


class SoftCell(NamedTuple):
    """``values`` (n, m, 3): a cell's share and its derivatives along s and t per mm, at places ``step`` mm apart, row
    by row along t, from -``half_s`` and -``half_t`` mm beside the microlens' centre."""

    values: NDArray[np.float32]
    step: float
    half_s: float
    half_t: float


def soft_cell(corners: Array, pitch_mm: float, blur_mm: float) -> SoftCell:
    """The cell with the ``corners`` (n, 2) mm, clockwise in (s, t), convolved with a Gaussian of standard deviation
    ``blur_mm``."""
    step = max(blur_mm / STEPS, FINEST * pitch_mm)
    most = np.abs(corners).max(0) + REACH * blur_mm
    n, m = (ceil(float(each) / step) + 1 for each in most)
    t = ((np.arange((2 * m + 1) * WITHIN) + 0.5) / WITHIN - (m + 0.5)) * step
    low, high = _chords(corners, t)
    edges = (np.arange(2 * n + 2) - (n + 0.5)) * step
    lengths = np.minimum(high[:, None], edges[1:]) - np.maximum(low[:, None], edges[:-1])
    cell = np.clip(lengths / step, 0.0, 1.0).reshape(2 * m + 1, WITHIN, -1).mean(1)
    cell *= _area(corners) / (cell.sum() * step * step)
    # squares of a step have blurred by their own variance
    sigma = sqrt(max((blur_mm / step) ** 2 - 1 / 12, 0.01))
    orders = ((0, 0), (0, 1), (1, 0))
    all_of = [gaussian_filter(cell, sigma, order, mode="constant", truncate=5.0) for order in orders]
    values = np.stack([all_of[0], all_of[1] / step, all_of[2] / step], -1)
    return SoftCell(values.astype(np.float32), step, n * step, m * step)


def _chords(corners: Array, t: Array) -> tuple[Array, Array]:
    """Where lines along s at ``t`` (n,) enter and leave the cell (n,); they leave before they enter where they miss
    it."""
    low, high = np.full(t.size, -np.inf), np.full(t.size, np.inf)
    for (s0, t0), (s1, t1) in zip(corners, np.roll(corners, -1, 0), strict=True):
        if t1 == t0:
            high = np.where((t - t0) * (s1 - s0) <= 0.0, high, -np.inf)
            continue
        crossing = s0 + (t - t0) * ((s1 - s0) / (t1 - t0))
        if t1 > t0:  # clockwise: the cell is at greater s
            low = np.maximum(low, crossing)
        else:
            high = np.minimum(high, crossing)
    return low, high


def _area(corners: Array) -> float:
    s, t = corners.T
    return 0.5 * abs(float(np.sum(s * np.roll(t, -1) - t * np.roll(s, -1))))


def weights_of_sub_pixels(count: int, blur_px: float) -> NDArray[np.float32]:
    """Of light at the middle of each ``count``-th of a pixel the shares (count, neighbours) that fall on the pixel
    itself, the middle one, and on its neighbours on both sides, where a Gaussian of standard deviation ``blur_px``
    spreads it."""
    reach = ceil(0.5 + 4.0 * blur_px - 0.5 / count)
    place = (np.arange(count) + 0.5) / count - 0.5
    off = np.arange(-reach, reach + 1) - place[:, None]
    share = ndtr((off + 0.5) / blur_px) - ndtr((off - 0.5) / blur_px)
    return np.asarray(share / share.sum(1, keepdims=True), np.float32)
