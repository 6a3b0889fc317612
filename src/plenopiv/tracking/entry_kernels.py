"""Lists of pixels that points light: an image of them, and lists of other points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part


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
def number_lit(
    pixel: NDArray[np.int32],  # (entries,)
    first: int,  # the least of them
    number: NDArray[np.int32],  # (pixels from the first to the last,), zeros on entry: to work in
    lit: NDArray[np.int64],  # filled as far as there are pixels: which any entry has, ascending
    own: NDArray[np.int32],  # (entries,), filled: the number of each one's pixel among these
) -> int:  # fmt: skip
    """Number the pixels that entries have; how many."""
    for e in range(pixel.size):
        number[np.uint32(pixel[e] - first)] = 1
    count = 0
    for p in range(number.size):
        if number[p] > 0:
            lit[count], number[p] = first + p, count
            count += 1
    for e in range(pixel.size):
        own[e] = number[np.uint32(pixel[e] - first)]
    return count


@kernel
def add_where(
    lit: NDArray[np.int64], counts: NDArray[np.float64],  # (k,): pixels, ascending, and what is to be added there
    which: NDArray[np.int64],  # (m,): pixels, ascending
    values: NDArray[np.float64],  # (m,): of these, added to
) -> None:  # fmt: skip
    """Add counts of some pixels to values of some pixels, where these are the same."""
    at = 0
    for n in range(which.size):
        while at < lit.size and lit[at] < which[n]:
            at += 1
        if at < lit.size and lit[at] == which[n]:
            values[n] += counts[at]


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


@part
def _take(
    at: int, end: int, pixel_a: NDArray[np.int32], share_a: NDArray[np.float32], gradient_a: NDArray[np.float32],
    to: int, to_end: int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
) -> None:  # fmt: skip
    """Copy entries ``at`` to ``end`` to the room from ``to`` to ``to_end``; the rest of it has no light, in the first
    pixel, or in the one that was there first."""
    count = min(end - at, to_end - to)
    off = at - to
    for e in range(np.uint64(to), np.uint64(to + count)):
        pixel[e], share[e] = pixel_a[e + off], share_a[e + off]
        for q in range(3):
            gradient[e, q] = gradient_a[e + off, q]
    for e in range(np.uint64(to + count), np.uint64(to_end)):
        pixel[e], share[e] = pixel_a[at] if end > at else pixel[to], 0.0
        for q in range(3):
            gradient[e, q] = 0.0


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
    """Copy the entries of points ``begin`` to ``end`` from two lists of points; where there is more room, entries
    without light follow, and where there is less, the last are left out."""
    first = start_a.size - 1
    for n in range(begin, end):
        k = source[n]
        if k < first:
            _take(
                start_a[k], start_a[k + 1], pixel_a, share_a, gradient_a, start[n], start[n + 1], pixel, share, gradient
            )
        else:
            k -= first
            _take(
                start_b[k], start_b[k + 1], pixel_b, share_b, gradient_b, start[n], start[n + 1], pixel, share, gradient
            )


@kernel
def replace_entries(
    begin: int, end: int,
    start_a: NDArray[np.int64], pixel_a: NDArray[np.int32], share_a: NDArray[np.float32],
    gradient_a: NDArray[np.float32],
    places: NDArray[np.int64],  # (points,): the numbers of these among all
    start: NDArray[np.int64], pixel: NDArray[np.int32], share: NDArray[np.float32],
    gradient: NDArray[np.float32],  # of all points, changed
) -> None:  # fmt: skip
    """Write the entries of points ``begin`` to ``end`` of a list in the places of others, which have room for them."""
    for k in range(begin, end):
        n = places[k]
        _take(start_a[k], start_a[k + 1], pixel_a, share_a, gradient_a, start[n], start[n + 1], pixel, share, gradient)


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
