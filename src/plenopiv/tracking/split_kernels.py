"""Normal equations of what a particle and its second derivatives explain of what is left in its pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part

FREE = 5  # parameters of one particle: stray light, light, place
TERMS = FREE + 6  # and second derivatives by xx, yy, zz, xy, xz, yz
PLACES = 4  # of each particle: its own, and one along each axis

Int = NDArray[np.int64]
Array = NDArray[np.float64]


@part
def _reach(n: int, start: Int, pixel: NDArray[np.int32]) -> tuple[int, int, int]:
    """The first and the last pixel of particle n at all its places; how many entries."""
    low, high = 2**31 - 1, -1
    first, last = start[PLACES * n], start[PLACES * (n + 1)]
    for e in range(first, last):
        low, high = min(low, int(pixel[e])), max(high, int(pixel[e]))
    return low, high, int(last - first)


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
    step: float,  # units: each particle is listed at its place, and then so far along x, y and z
    unit: Array, light: Array,  # (3,) mm; (n,) counts
    weight: NDArray[np.float32], residual: Array,  # (pixels,): 1 / std, counts
    normal: Array, right: Array,  # (m, 11, 11), (m, 11), filled
) -> None:  # fmt: skip
    """Of the particles ``begin`` to ``end``, lengths in units: terms are the same light in all pixels, the particle's
    share, its derivatives by place, and the six second ones, differences of those, xy and so on for both orders."""
    most, span = 0, 0
    for n in range(begin, end):
        low, high, count = _reach(n, start, pixel)
        most, span = max(most, count), max(span, high - low + 1)
    place, terms, mine = np.full(span, -1, np.int32), np.empty((most, TERMS)), np.empty(most, np.int32)
    for n in range(begin, end):
        low, _, _ = _reach(n, start, pixel)
        count = 0
        for s in range(PLACES):
            for e in range(start[PLACES * n + s], start[PLACES * n + s + 1]):
                at = _row_of(pixel[e], low, place, mine, terms, count)
                count = max(count, at + 1)
                gx, gy, gz = gradient[e, 0] * unit[0], gradient[e, 1] * unit[1], gradient[e, 2] * unit[2]
                if s == 0:
                    terms[at, 1] += share[e]
                    terms[at, 2] += gx
                    terms[at, 3] += gy
                    terms[at, 4] += gz
                gx, gy, gz = gx / step, gy / step, gz / step
                if s == 0:
                    terms[at, FREE] -= gx
                    terms[at, FREE + 1] -= gy
                    terms[at, FREE + 2] -= gz
                    terms[at, FREE + 3] -= gx + gy
                    terms[at, FREE + 4] -= gx + gz
                    terms[at, FREE + 5] -= gy + gz
                elif s == 1:
                    terms[at, FREE] += gx
                    terms[at, FREE + 3] += gy
                    terms[at, FREE + 4] += gz
                elif s == 2:
                    terms[at, FREE + 1] += gy
                    terms[at, FREE + 3] += gx
                    terms[at, FREE + 5] += gz
                else:
                    terms[at, FREE + 2] += gz
                    terms[at, FREE + 4] += gx
                    terms[at, FREE + 5] += gy
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
