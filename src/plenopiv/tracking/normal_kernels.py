"""The normal equations of particles that share pixels: sums over pixels, block by block.

Particle i and particle j are coupled by the block  sum_p J_ip^T J_jp  over the pixels that both light, J the whitened
derivatives of a pixel's light by the four unknowns of a particle.

Entries are counted without a sign: an index that may count from the end keeps Numba's loops from being vectorised.
"""

from __future__ import annotations

from math import sqrt

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
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            w, r = np.float64(weight[np.uint32(pixel[e])]), np.float64(pull[np.uint32(pixel[e])])
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
def light_changes(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    which: Int,  # (k,)
    step: NDArray[np.float32],  # (k, 4): mm times counts, and counts
    bounds: Int,  # (parts + 1,): of the k particles, where each part begins
    out: NDArray[np.float32],  # (parts, pixels), zeros on entry, filled
) -> None:  # fmt: skip
    """By how much the light in each pixel changes with a small step of the particles ``which``, in parts."""
    for p in range(begin, end):
        for k in range(bounds[p], bounds[p + 1]):
            dx, dy, dz, de = step[k, 0], step[k, 1], step[k, 2], step[k, 3]
            for e in range(np.uint64(start[which[k]]), np.uint64(start[which[k] + 1])):
                out[p, np.uint32(pixel[e])] += (
                    dx * gradient[e, 0] + dy * gradient[e, 1] + dz * gradient[e, 2] + de * share[e]
                )


@kernel
def gather_changes(
    begin: int, end: int,
    parts: NDArray[np.float32],  # (parts, pixels); zeros afterwards
    square: NDArray[np.float32],  # (pixels,): 1 / variance
    out: NDArray[np.float32],  # (pixels,), filled
) -> None:  # fmt: skip
    """The changes in the pixels ``begin`` to ``end`` of all parts, over the variance."""
    for p in range(begin, end):
        total = np.float32(0.0)
        for part in range(parts.shape[0]):
            total += parts[part, p]
            parts[part, p] = np.float32(0.0)
        out[p] = square[p] * total


@kernel
def sums_of_changes(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    which: Int, changed: NDArray[np.float32],  # (k,); (pixels,)
    out: NDArray[np.float32],  # (k, 4), filled
) -> None:  # fmt: skip
    """The derivatives of the particles ``which[begin:end]`` times changes of pixels."""
    for k in range(begin, end):
        sx, sy, sz, se = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for e in range(np.uint64(start[which[k]]), np.uint64(start[which[k] + 1])):
            c = changed[np.uint32(pixel[e])]
            sx += gradient[e, 0] * c
            sy += gradient[e, 1] * c
            sz += gradient[e, 2] * c
            se += share[e] * c
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = sx, sy, sz, se


@kernel
def telling_entries(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    weight: NDArray[np.float32],
    telling: float,  # of what an entry says on the average, that an entry must say to be kept
    told: NDArray[np.bool_], count: Int,  # (m,), (n,), filled: which are kept, and how many of each particle's
) -> None:  # fmt: skip
    """Which entries of the particles ``begin`` to ``end`` say something: squares of derivatives over standard
    deviations, each as a share of the particle's."""
    for i in range(begin, end):
        own_x, own_y, own_z, own_e, entries = 0.0, 0.0, 0.0, 0.0, 0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            square = np.float64(weight[np.uint32(pixel[e])]) ** 2
            entries += share[e] != 0.0 or gradient[e, 2] != 0.0
            own_x += square * gradient[e, 0] ** 2
            own_y += square * gradient[e, 1] ** 2
            own_z += square * gradient[e, 2] ** 2
            own_e += square * share[e] ** 2
        least = 4.0 * telling / max(entries, 1)
        of_x, of_y, of_z, of_e = 1.0 / own_x, 1.0 / own_y, 1.0 / own_z, 1.0 / own_e
        kept = 0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            square = np.float64(weight[np.uint32(pixel[e])]) ** 2
            said = square * (
                of_x * gradient[e, 0] ** 2 + of_y * gradient[e, 1] ** 2 + of_z * gradient[e, 2] ** 2
                + of_e * share[e] ** 2
            )  # fmt: skip
            lit = share[e] != 0.0 or gradient[e, 2] != 0.0  # others are room for entries
            told[e] = lit and not said < least  # all of them where no pixel can be used
            kept += told[e]
        count[i] = kept


@kernel
def pick(begin: int, end: int, start: Int, told: NDArray[np.bool_], kept_start: Int, entry: NDArray[np.int32]) -> None:
    """The numbers of the entries that are kept of the particles ``begin`` to ``end``."""
    for i in range(begin, end):
        to = kept_start[i]
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            if told[e]:
                entry[to] = np.int32(e)
                to += 1


@kernel
def by_pixels(
    start: Int, pixel: NDArray[np.int32],
    pixel_end: Int,  # (pixels,), zeros on entry, filled: where a pixel's entries end once sorted
    rank: NDArray[np.int32], particle: NDArray[np.int32],  # (m,), filled: where each goes; whose it is, sorted
) -> None:  # fmt: skip
    """Sort entries by their pixels; those of one pixel stay in the order of particles."""
    for e in range(pixel.size):
        pixel_end[pixel[e]] += 1
    total = 0
    for p in range(pixel_end.size):
        count = pixel_end[p]
        pixel_end[p] = total
        total += count
    for i in range(start.size - 1):
        for e in range(start[i], start[i + 1]):
            to = pixel_end[pixel[e]]
            pixel_end[pixel[e]] = to + 1
            rank[e] = to
            particle[to] = i


@kernel
def whiten(
    begin: int, end: int,
    start: Int, pixel: NDArray[np.int32], entry: NDArray[np.int32],  # of the entries kept
    share: NDArray[np.float32], gradient: NDArray[np.float32],  # of all
    light: NDArray[np.float64], unit: NDArray[np.float64], weight: NDArray[np.float32], rank: NDArray[np.int32],
    whitened: NDArray[np.float32],  # (m, 4), filled
) -> None:  # fmt: skip
    """Derivatives of each kept entry over its pixel's standard deviation, sorted by pixels."""
    for i in range(begin, end):
        ux, uy, uz, e0 = (
            np.float32(light[i] * unit[0]), np.float32(light[i] * unit[1]), np.float32(light[i] * unit[2]),
            np.float32(light[i]),
        )  # fmt: skip
        for k in range(start[i], start[i + 1]):
            w, to, e = weight[pixel[k]], rank[k], entry[k]
            whitened[to, 0] = w * ux * gradient[e, 0]
            whitened[to, 1] = w * uy * gradient[e, 1]
            whitened[to, 2] = w * uz * gradient[e, 2]
            whitened[to, 3] = w * e0 * share[e]


@kernel
def mean_misfit(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32],
    chi2: NDArray[np.float64],  # (pixels,); NaN: cannot be used
    out: NDArray[np.float64],  # (n,), filled
) -> None:  # fmt: skip
    """Mean of chi^2 of the pixels of the particles ``begin`` to ``end``, weighed with their light."""
    for i in range(begin, end):
        total, weight = 0.0, 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            value = chi2[np.uint32(pixel[e])]
            if value == value:
                total += share[e] * value
                weight += share[e]
        out[i] = total / max(weight, 1e-9)


@kernel
def light_equations(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], share: NDArray[np.float32],
    weight: NDArray[np.float64], residual: NDArray[np.float64],  # (pixels,): 1 / variance, counts
    whitened: NDArray[np.float32],  # (m,), filled
    own: NDArray[np.float64], slope: NDArray[np.float64],  # (n,), filled
) -> None:  # fmt: skip
    """Of the particles ``begin`` to ``end``, their light alone unknown: entries over standard deviations, the sum of
    their squares, and the right side."""
    for i in range(begin, end):
        total, right = 0.0, 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            w = weight[np.uint32(pixel[e])]
            value = np.float32(share[e] * sqrt(w))
            whitened[e] = value
            total += np.float64(value) * value
            right += share[e] * w * residual[np.uint32(pixel[e])]
        own[i], slope[i] = total, right


@kernel
def count_later(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], pixel_end: Int, rank: NDArray[np.int32],
    particle: NDArray[np.int32], count: Int,
) -> None:  # fmt: skip
    """How many particles, itself and those that come after it, share pixels with each of the particles ``begin`` to
    ``end``; itself also where it has none, as all its pixels may be unusable."""
    seen = np.full(count.size, -1, np.int32)
    for i in range(begin, end):
        found = 0
        for e in range(start[i], start[i + 1]):
            for k in range(np.uint32(rank[e]), np.uint32(pixel_end[pixel[e]])):
                j = np.uint32(particle[k])
                if seen[j] != i:
                    seen[j] = i
                    found += 1
        count[i] = max(found, 1)


@kernel
def sum_later(
    begin: int, end: int, start: Int, pixel: NDArray[np.int32], pixel_end: Int, rank: NDArray[np.int32],
    particle: NDArray[np.int32],
    whitened: NDArray[np.float32],  # (m, 4)
    block_start: Int,  # (n + 1,)
    neighbour: NDArray[np.int32],  # (blocks,), filled
    block: NDArray[np.float32],  # (blocks, 4, 4), zeros on entry, filled
) -> None:  # fmt: skip
    """Sum the blocks of the particles ``begin`` to ``end`` with themselves and those after them, in the order in which
    these are met."""
    where = np.full(start.size - 1, -1, np.int64)
    for i in range(begin, end):
        following = block_start[i] + 1
        where[i], neighbour[following - 1] = following - 1, np.int32(i)
        for e in range(start[i], start[i + 1]):
            first = np.uint32(rank[e])
            a0, a1, a2, a3 = whitened[first, 0], whitened[first, 1], whitened[first, 2], whitened[first, 3]
            low = pixel_end[pixel[e] - 1] if pixel[e] > 0 else 0
            begin_k = rank[e]
            while begin_k > low and particle[begin_k - 1] == i:  # its own entry before, of a pixel that it lights twice
                begin_k -= 1
            for k in range(np.uint32(begin_k), np.uint32(pixel_end[pixel[e]])):
                j = np.uint32(particle[k])
                if where[j] < 0:
                    where[j] = following
                    neighbour[following] = np.int32(j)
                    following += 1
                at = np.uint64(where[j])
                for q in range(4):
                    b = whitened[k, q]
                    block[at, 0, q] += a0 * b
                    block[at, 1, q] += a1 * b
                    block[at, 2, q] += a2 * b
                    block[at, 3, q] += a3 * b
        for n in range(block_start[i], following):
            where[neighbour[n]] = -1


@kernel
def both_ways(
    later_start: Int, later: NDArray[np.int32], of_later: NDArray[np.float32],  # what ``sum_later`` fills
    block_start: Int,  # (n + 1,), zeros on entry, filled
    neighbour: NDArray[np.int32], block: NDArray[np.float32],  # (blocks,), (blocks, 4, 4), filled
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
