"""Lists of pixels that points light: an image of them, and lists of other points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel


@kernel
def sum_light(
    start: NDArray[np.int64], pixel: NDArray[np.int32], share: NDArray[np.float32],
    light: NDArray[np.float64],  # (points,): counts of each
    out: NDArray[np.float64],  # (pixels,): added to
) -> None:  # fmt: skip
    """Add the light of points to an image."""
    for n in range(light.size):
        for e in range(np.uint64(start[n]), np.uint64(start[n + 1])):
            out[np.uint32(pixel[e])] += light[n] * share[e]


@kernel
def shift_shares(
    start: NDArray[np.int64], gradient: NDArray[np.float32],
    which: NDArray[np.int64], by_mm: NDArray[np.float64],  # (k,), (k, 3)
    share: NDArray[np.float32],  # (entries,): added to
) -> None:  # fmt: skip
    """Add to the shares of the points ``which`` what their derivatives say of a small step."""
    for k in range(which.size):
        dx, dy, dz = by_mm[k, 0], by_mm[k, 1], by_mm[k, 2]
        for e in range(np.uint64(start[which[k]]), np.uint64(start[which[k] + 1])):
            share[e] += np.float32(dx * gradient[e, 0] + dy * gradient[e, 1] + dz * gradient[e, 2])


@kernel
def take_entries(
    begin: int, end: int,
    start_a: NDArray[np.int64], pixel_a: NDArray[np.int32], share_a: NDArray[np.float32],
    gradient_a: NDArray[np.float32],
    start_b: NDArray[np.int64], pixel_b: NDArray[np.int32], share_b: NDArray[np.float32],
    gradient_b: NDArray[np.float32],
    source: NDArray[np.int64],  # (points,): of a, counted from 0, and of b, counted on
    start: NDArray[np.int64], pixel: NDArray[np.int32], share: NDArray[np.float32],
    gradient: NDArray[np.float32],  # (entries, 3); of the points taken, all but start filled
) -> None:  # fmt: skip
    """Copy the entries of points ``begin`` to ``end`` from two lists of points."""
    first = start_a.size - 1
    for n in range(begin, end):
        k = source[n]
        if k < first:
            at = start_a[k]
            for e in range(np.uint64(start[n]), np.uint64(start[n + 1])):
                pixel[e], share[e] = pixel_a[at], share_a[at]
                for q in range(3):
                    gradient[e, q] = gradient_a[at, q]
                at += 1
        else:
            at = start_b[k - first]
            for e in range(np.uint64(start[n]), np.uint64(start[n + 1])):
                pixel[e], share[e] = pixel_b[at], share_b[at]
                for q in range(3):
                    gradient[e, q] = gradient_b[at, q]
                at += 1


@kernel
def close_up(
    start: NDArray[np.int64],  # (points + 1,): where a point's entries begin; changed to where they do afterwards
    count: NDArray[np.int64],  # (points,): how many of them there are
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
) -> None:  # fmt: skip
    """Move the entries of all points up, in place, so that none is empty between them."""
    to = 0
    for n in range(count.size):
        first = start[n]
        start[n] = to
        for e in range(first, first + count[n]):
            pixel[to], share[to] = pixel[e], share[e]
            for q in range(3):
                gradient[to, q] = gradient[e, q]
            to += 1
    start[count.size] = to
