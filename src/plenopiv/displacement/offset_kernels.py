"""Kernels of discrete window offset (``offset``): sums over two windows, and the walk to the highest correlation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.peaks import FARTHEST, Y, gaussian_offset, untilted
from plenopiv.kernels import inlined, kernel, part

MOVES = 3  # steps of a voxel that the highest correlation may be away from the first estimate
# Second windows beside the one that the first estimate says, z, y, x: along each axis, and along two of them.
STEPS = np.array(
    [(0, 0, 0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
    + [(s, t, 0) for s in (-1, 1) for t in (-1, 1)]
    + [(s, 0, t) for s in (-1, 1) for t in (-1, 1)]
    + [(0, s, t) for s in (-1, 1) for t in (-1, 1)]
)
BESIDE = len(STEPS)


@inlined
def product_of(one: NDArray[np.float32], two: NDArray[np.float32], begin: int, count: int) -> np.float32:
    """Sum of one[n] two[begin + n]."""
    first, second, total = one[:count], two[begin : begin + count], np.float32(0)
    for n in range(count):
        total += first[n] * second[n]
    return total


@inlined
def copied(
    b: NDArray[np.float32],
    z: int,
    y: int,
    x: int,
    size: tuple[int, int, int],
    plane: NDArray[np.float32],
    light: NDArray[np.float64],
    squares: NDArray[np.float64],
    k: int,
) -> None:
    """Copy plane k of the second window with a voxel more on each side into ``plane``; add the light of its rows, and
    its square, to those of the windows of STEPS that hold them."""
    nz, ny, nx = size
    for j in range(-1, ny + 1):
        row, out = b[z, y + j, x - 1 : x + nx + 1], plane[(j + 1) * (nx + 2) : (j + 2) * (nx + 2)]
        s, q = np.float32(0), np.float32(0)
        for i in range(nx + 2):
            out[i] = row[i]
        for i in range(1, nx + 1):
            s += row[i]
            q += row[i] * row[i]
        first, second, before, after = row[0], row[1], row[nx], row[nx + 1]
        for n in range(BESIDE):
            along_z, along_y, along_x = STEPS[n, 0], STEPS[n, 1], STEPS[n, 2]
            if 0 <= k - along_z < nz and 0 <= j - along_y < ny:
                light[n] += s
                squares[n] += q
                if along_x < 0:
                    light[n] += first - before
                    squares[n] += first * first - before * before
                elif along_x > 0:
                    light[n] += after - second
                    squares[n] += after * after - second * second


@part
def add_sums(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    at: NDArray[np.int64],
    to: NDArray[np.int64],
    size: tuple[int, int, int],
    sums: NDArray[np.float64],
) -> None:
    """Numerator of C and its denominator squared: added to ``sums`` (2, BESIDE), unless the second window is even.

    Of a window of volume ``a`` with the one of ``b`` at ``to`` and those beside it (STEPS).
    Planes are copied into rows that follow one another, so that a plane's products are one sum.
    """
    nz, ny, nx = size
    wide = nx + 2
    products, light, squares = np.zeros(BESIDE), np.zeros(BESIDE), np.zeros(BESIDE)
    planes, own = np.zeros((3, (ny + 2) * wide), np.float32), np.zeros(ny * wide, np.float32)
    total = 0.0
    for k in range(-1, nz + 1):
        copied(b, to[0] + k, to[1], to[2], size, planes[k % 3], light, squares, k)
        some = np.float32(0)
        for j in range(ny if k > 0 else 0):
            row, out = a[at[0] + k - 1, at[1] + j, at[2] : at[2] + nx], own[j * wide :]
            for i in range(nx):
                out[i] = row[i]
                some += row[i]
        if some == np.float32(0):
            continue
        total += float(some)
        for n in range(BESIDE):
            along_z, along_y, along_x = STEPS[n, 0], STEPS[n, 1], STEPS[n, 2]
            begin = (1 + along_y) * wide + 1 + along_x
            products[n] += product_of(own, planes[(k + 2 + along_z) % 3], begin, ny * wide - 2)
    count = nz * ny * nx
    mean = total / count
    for n in range(BESIDE):
        spread = squares[n] - light[n] * light[n] / count
        if spread > 1e-6 * squares[n]:
            sums[0, n] += products[n] - mean * light[n]
            sums[1, n] += spread


@part
def normalise(sums: NDArray[np.float64], c: NDArray[np.float64]) -> None:
    """C (BESIDE,) of ``sums``; 0 where the second windows are even."""
    for n in range(BESIDE):
        c[n] = sums[0, n] / np.sqrt(sums[1, n]) if sums[1, n] > 0.0 else 0.0


@part
def correlations(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    at: NDArray[np.int64],
    to: NDArray[np.int64],
    size: tuple[int, int, int],
    c: NDArray[np.float64],
) -> None:
    """C of the windows of ``add_sums``: ``c`` (BESIDE,)."""
    sums = np.zeros((2, BESIDE))
    add_sums(a, b, at, to, size, sums)
    normalise(sums, c)


@part
def placed(
    corner: NDArray[np.int64],
    whole: NDArray[np.int64],
    size: NDArray[np.int64],
    room: tuple[int, int, int],
    at: NDArray[np.int64],
    to: NDArray[np.int64],
) -> bool:
    """Write the first voxels (z, y, x) of two windows ``whole`` voxels apart about ``corner``, in a volume of ``room``
    voxels, to ``at`` and ``to``. Returns whether they fit."""
    inside = True
    for axis in range(3):
        back = whole[axis] // 2
        one = corner[axis] - back
        two = one + whole[axis]
        # both move together to where they, and the second's neighbours, lie inside
        low, high = min(one, two - 1), max(one, two + 1) + size[axis]
        shift = max(0, -low) - max(0, high - room[axis])
        inside &= low + shift >= 0 and high + shift <= room[axis] and abs(shift) <= size[axis] // 8
        at[axis], to[axis] = one + shift, two + shift
    return inside


@kernel
def find_places(
    corners: NDArray[np.int64], whole: NDArray[np.int64], size: NDArray[np.int64], room: tuple[int, int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """``placed`` of many windows: first voxels (count, 3) of both, and which fit."""
    at, to, fits = np.empty_like(corners), np.empty_like(corners), np.empty(corners.shape[0], np.bool_)
    for n in range(corners.shape[0]):
        fits[n] = placed(corners[n], whole[n], size, room, at[n], to[n])
    return at, to, fits


@part
def settled(c: NDArray[np.float64], whole: NDArray[np.int64], vector: NDArray[np.float64]) -> bool:
    """Whether the middle of ``c`` (BESIDE,) is the highest; ``vector`` is then its maximum, unless that is not
    positive. Otherwise ``whole`` moves to the highest. Peaks may be slanted (``peaks.untilted``)."""
    best = 0
    for k in range(1, BESIDE):
        best = k if c[k] > c[best] else best
    if best > 0:
        for axis in range(3):
            whole[axis] += STEPS[best, axis]
        return False
    if c[0] > 0.0:
        r, untilt, along = np.zeros((3, 3, 3)), np.empty((3, 3)), np.empty(3)
        for k in range(BESIDE):
            r[1 + STEPS[k, 0], 1 + STEPS[k, 1], 1 + STEPS[k, 2]] = c[k]
        untilted(r, Y, Y, Y, untilt)
        for axis in range(3):
            along[2 - axis] = gaussian_offset(c[2 * axis + 1], c[0], c[2 * axis + 2])
        for axis in range(3):
            off = untilt[axis, 0] * along[0] + untilt[axis, 1] * along[1] + untilt[axis, 2] * along[2]
            vector[axis] = whole[2 - axis] + min(FARTHEST, max(-FARTHEST, off))
    return True


@kernel
def refine(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    corners: NDArray[np.int64],
    size: NDArray[np.int64],
    vectors: NDArray[np.float64],
    again: NDArray[np.bool_],
) -> None:
    """``vectors`` (count, 3), x y z, of windows whose first voxels are ``corners`` (count, 3), z y x; ``again``: which
    were found."""
    at, to, whole, c = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64), np.empty(BESIDE)
    for n in range(corners.shape[0]):
        for axis in range(3):
            whole[axis] = np.int64(np.rint(vectors[n, 2 - axis]))
        for _ in range(MOVES + 1):
            if not placed(corners[n], whole, size, a.shape, at, to):
                break
            correlations(a, b, at, to, (size[0], size[1], size[2]), c)
            if settled(c, whole, vectors[n]):
                again[n] = c[0] > 0.0
                break


@kernel
def add_to(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    corners: NDArray[np.int64],
    size: NDArray[np.int64],
    whole: NDArray[np.int64],
    sums: NDArray[np.float64],
) -> None:
    """Add those of one more pair to the ``sums`` (count, 2, BESIDE) of windows ``whole`` (count, 3) voxels apart.
    Where they do not fit, the sums become NaN."""
    at, to = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(corners.shape[0]):
        if placed(corners[n], whole[n], size, a.shape, at, to):
            add_sums(a, b, at, to, (size[0], size[1], size[2]), sums[n])
        else:
            sums[n] = np.nan


@kernel
def settle(
    sums: NDArray[np.float64],
    whole: NDArray[np.int64],
    vectors: NDArray[np.float64],
    again: NDArray[np.bool_],
    moving: NDArray[np.bool_],
) -> None:
    """One step of ``refine`` from the sums over all pairs; ``moving``: which windows need another."""
    c = np.empty(BESIDE)
    for n in range(sums.shape[0]):
        moving[n] = False
        if not np.isnan(sums[n, 0, 0]):
            normalise(sums[n], c)
            moving[n] = not settled(c, whole[n], vectors[n])
            again[n] = c[0] > 0.0 and not moving[n]
