"""Normal equations of what a particle and its second derivatives explain of what is left in its pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part

FREE = 5  # parameters of one particle: stray light, light, place
TERMS = FREE + 6  # and second derivatives by xx, yy, zz, xy, xz, yz

Int = NDArray[np.int64]
Array = NDArray[np.float64]


@part
def _reach(
    n: int, steps: int, start: Int, pixel: NDArray[np.int32], moved_start: Int, moved_pixel: NDArray[np.int32]
) -> tuple[int, int, int]:
    """The first and the last pixel of particle n and of its steps; how many entries."""
    low, high = 2**31 - 1, -1
    for e in range(start[n], start[n + 1]):
        low, high = min(low, int(pixel[e])), max(high, int(pixel[e]))
    first, last = moved_start[steps * n], moved_start[steps * (n + 1)]
    for e in range(first, last):
        low, high = min(low, int(moved_pixel[e])), max(high, int(moved_pixel[e]))
    return low, high, int(start[n + 1] - start[n] + last - first)


@part
def _row_of(pixel: int, low: int, place: NDArray[np.int32], mine: NDArray[np.int32], terms: Array, count: int) -> int:
    """Which row of ``terms`` is the pixel's; the next one, ``count``, begun at zero, where it has none yet."""
    if place[pixel - low] < 0:
        place[pixel - low], mine[count] = count, pixel
        terms[count] = 0.0
    return int(place[pixel - low])


@kernel
def derivative_equations(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    moved_start: Int, moved_pixel: NDArray[np.int32], moved_gradient: NDArray[np.float32],  # steps of each, in order
    step: Array,  # (steps, 3), units: where to; sums to 0
    unit: Array, light: Array,  # (3,) mm; (n,) counts
    weight: NDArray[np.float32], residual: Array,  # (pixels,): 1 / std, counts
    normal: Array, right: Array,  # (m, 11, 11), (m, 11), filled
) -> None:  # fmt: skip
    """Of the particles ``begin`` to ``end``, lengths in units: terms are the same light in all pixels, the particle's
    share, its derivatives by place, and the six second ones, from those at places around, xy and so on for both
    orders."""
    steps = step.shape[0]
    square = 0.0  # of the steps along one axis
    for s in range(steps):
        square += step[s, 0] * step[s, 0]
    most, span = 0, 0
    for n in range(begin, end):
        low, high, count = _reach(n, steps, start, pixel, moved_start, moved_pixel)
        most, span = max(most, count), max(span, high - low + 1)
    place, terms, mine = np.full(span, -1, np.int32), np.empty((most, TERMS)), np.empty(most, np.int32)
    for n in range(begin, end):
        low, _, _ = _reach(n, steps, start, pixel, moved_start, moved_pixel)
        count = 0
        for e in range(start[n], start[n + 1]):
            at = _row_of(pixel[e], low, place, mine, terms, count)
            count = max(count, at + 1)
            terms[at, 1] += share[e]
            for q in range(3):
                terms[at, 2 + q] += gradient[e, q] * unit[q]
        for s in range(steps):
            for e in range(moved_start[steps * n + s], moved_start[steps * n + s + 1]):
                at = _row_of(moved_pixel[e], low, place, mine, terms, count)
                count = max(count, at + 1)
                gx, gy, gz = (
                    moved_gradient[e, 0] * unit[0] / square, moved_gradient[e, 1] * unit[1] / square,
                    moved_gradient[e, 2] * unit[2] / square,
                )  # fmt: skip
                sx, sy, sz = step[s, 0], step[s, 1], step[s, 2]
                terms[at, FREE] += gx * sx
                terms[at, FREE + 1] += gy * sy
                terms[at, FREE + 2] += gz * sz
                terms[at, FREE + 3] += gx * sy + gy * sx
                terms[at, FREE + 4] += gx * sz + gz * sx
                terms[at, FREE + 5] += gy * sz + gz * sy
        normal[n] = 0.0
        right[n] = 0.0
        for at in range(count):
            place[mine[at] - low] = -1
            terms[at, 0] = 1.0 / count
            factor = light[n] * np.float64(weight[mine[at]])
            left = residual[mine[at]] * np.float64(weight[mine[at]])
            for a in range(TERMS):
                terms[at, a] *= factor
            for a in range(TERMS):
                right[n, a] += terms[at, a] * left
                for b in range(a, TERMS):
                    normal[n, a, b] += terms[at, a] * terms[at, b]
        for a in range(TERMS):
            for b in range(a):
                normal[n, a, b] = normal[n, b, a]
