"""The normal equations of particles that share pixels: sums over pixels, block by block.

Particle i and particle j are coupled by the block  sum_p J_ip^T J_jp  over the pixels that both light, J the whitened
derivatives of a pixel's light by the four unknowns of a particle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel

Int = NDArray[np.int64]


@kernel
def own_equations(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    light: NDArray[np.float64], unit: NDArray[np.float64],  # (n,), (3,)
    weight: NDArray[np.float32], pull: NDArray[np.float32],  # of each pixel: 1 / std, residual / std
    own: NDArray[np.float64], slope: NDArray[np.float64],  # (n, 4, 4), (n, 4), filled
) -> None:  # fmt: skip
    """Of particles ``begin`` to ``end`` the block that each has by itself, and the right side."""
    for i in range(begin, end):
        total = np.zeros(14)
        e0, ux, uy, uz = light[i], light[i] * unit[0], light[i] * unit[1], light[i] * unit[2]
        for e in range(start[i], start[i + 1]):
            w, r = np.float64(weight[pixel[e]]), np.float64(pull[pixel[e]])
            a, b, c, d = w * ux * gradient[e, 0], w * uy * gradient[e, 1], w * uz * gradient[e, 2], w * e0 * share[e]
            total[0] += a * a
            total[1] += a * b
            total[2] += a * c
            total[3] += a * d
            total[4] += b * b
            total[5] += b * c
            total[6] += b * d
            total[7] += c * c
            total[8] += c * d
            total[9] += d * d
            total[10] += a * r
            total[11] += b * r
            total[12] += c * r
            total[13] += d * r
        k = 0
        for p in range(4):
            for q in range(p, 4):
                own[i, p, q] = total[k]
                own[i, q, p] = total[k]
                k += 1
            slope[i, p] = total[10 + p]


@kernel
def whiten(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    light: NDArray[np.float64], unit: NDArray[np.float64], weight: NDArray[np.float32],
    whitened: NDArray[np.float32], particle: NDArray[np.int32],  # (m, 4), (m,), filled
) -> None:  # fmt: skip
    """Derivatives of each entry over its pixel's standard deviation, and whose entry it is."""
    for i in range(begin, end):
        ux, uy, uz, e0 = (
            np.float32(light[i] * unit[0]), np.float32(light[i] * unit[1]), np.float32(light[i] * unit[2]),
            np.float32(light[i]),
        )  # fmt: skip
        for e in range(start[i], start[i + 1]):
            w = weight[pixel[e]]
            whitened[e, 0] = w * ux * gradient[e, 0]
            whitened[e, 1] = w * uy * gradient[e, 1]
            whitened[e, 2] = w * uz * gradient[e, 2]
            whitened[e, 3] = w * e0 * share[e]
            particle[e] = i


@kernel
def entries_of_pixels(pixel: NDArray[np.int32], pixel_start: Int, entry: NDArray[np.int32]) -> None:
    """Sort entries by their pixel. ``pixel_start`` (pixels + 1,), zeros on entry: where each one's begin in ``entry``
    (m,); both filled."""
    for e in range(pixel.size):
        pixel_start[pixel[e] + 1] += 1
    for p in range(pixel_start.size - 1):
        pixel_start[p + 1] += pixel_start[p]
    following = pixel_start.copy()
    for e in range(pixel.size):
        p = pixel[e]
        entry[following[p]] = e
        following[p] += 1


@kernel
def count_later(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], particle: NDArray[np.int32], pixel_start: Int,
    entry: NDArray[np.int32], count: Int,
) -> None:  # fmt: skip
    """How many particles, itself and those that come after it, share pixels with each of the particles ``begin`` to
    ``end``."""
    seen = np.full(count.size, -1, np.int64)
    for i in range(begin, end):
        found = 0
        for e in range(start[i], start[i + 1]):
            for k in range(pixel_start[pixel[e] + 1] - 1, pixel_start[pixel[e]] - 1, -1):
                j = particle[entry[k]]
                if j < i:
                    break
                if seen[j] != i:
                    seen[j] = i
                    found += 1
        count[i] = found


@kernel
def sum_later(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], particle: NDArray[np.int32], pixel_start: Int,
    entry: NDArray[np.int32],
    whitened: NDArray[np.float32],  # (m, 4)
    block_start: Int,  # (n + 1,)
    neighbour: NDArray[np.int32],  # (blocks,), filled
    block: NDArray[np.float64],  # (blocks, 4, 4), zeros on entry, filled
) -> None:  # fmt: skip
    """Sum the blocks of the particles ``begin`` to ``end`` with themselves and those after them, in the order in which
    these are met."""
    where = np.full(start.size - 1, -1, np.int64)
    for i in range(begin, end):
        following = block_start[i]
        for e in range(start[i], start[i + 1]):
            a0, a1, a2, a3 = whitened[e, 0], whitened[e, 1], whitened[e, 2], whitened[e, 3]
            for k in range(pixel_start[pixel[e] + 1] - 1, pixel_start[pixel[e]] - 1, -1):
                f = entry[k]
                j = particle[f]
                if j < i:
                    break
                at = where[j]
                if at < 0:
                    at = following
                    where[j] = at
                    neighbour[at] = j
                    following += 1
                for q in range(4):
                    b = whitened[f, q]
                    block[at, 0, q] += a0 * b
                    block[at, 1, q] += a1 * b
                    block[at, 2, q] += a2 * b
                    block[at, 3, q] += a3 * b
        for at in range(block_start[i], following):
            where[neighbour[at]] = -1


@kernel
def both_ways(
    later_start: Int, later: NDArray[np.int32], of_later: NDArray[np.float64],  # what ``sum_later`` fills
    block_start: Int,  # (n + 1,), zeros on entry, filled
    neighbour: NDArray[np.int32], block: NDArray[np.float64],  # (blocks,), (blocks, 4, 4), filled
) -> None:  # fmt: skip
    """Blocks of all pairs of particles from those of each with the ones after it."""
    n = block_start.size - 1
    for i in range(n):
        for at in range(later_start[i], later_start[i + 1]):
            block_start[i + 1] += 1
            if later[at] != i:
                block_start[later[at] + 1] += 1
    for i in range(n):
        block_start[i + 1] += block_start[i]
    following = block_start[:-1].copy()
    for i in range(n):
        for at in range(later_start[i], later_start[i + 1]):
            j = later[at]
            to = following[i]
            following[i] += 1
            neighbour[to] = j
            for p in range(4):
                for q in range(4):
                    block[to, p, q] = of_later[at, p, q]
            if j != i:
                to = following[j]
                following[j] += 1
                neighbour[to] = i
                for p in range(4):
                    for q in range(4):
                        block[to, q, p] = of_later[at, p, q]
