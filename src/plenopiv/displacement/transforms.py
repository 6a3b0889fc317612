"""Fourier transforms of windows, two real windows as one complex, sixteen lines at a time.

Lines along z and y lie side by side along x as they are; those along x are transposed on their way. A window is

    space      (2, nz, ny', nx'): real and imaginary part; ' rounded up to whole vectors
    spectrum   (2, nz, nx, ny'): x before y, as the last transposition leaves it

and stays in the second-level cache from one to the other. Lines are transformed by Stockham's method.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.butterflies import LANES, butterfly, transpose
from plenopiv.kernels import inlined, part, part_with_way_in

RADICES = (4, 5, 3, 2)
POINT = 2 * LANES  # floats of a complex point in working memory
ZERO, WIDE, SIDE = np.int64(0), np.int64(POINT), np.int64(LANES)  # as arguments: a plain number is a type of its own

_butterfly_2, _butterfly_3, _butterfly_4, _butterfly_5 = (butterfly(r) for r in (2, 3, 4, 5))


class Lines(NamedTuple):
    """How lines of so many ``points`` are transformed: the radix of each stage, and the factors of all stages."""

    points: int
    radices: NDArray[np.int64]
    twiddles: NDArray[np.float32]


def rounded_up(n: int) -> int:
    """The least multiple of LANES that is not less than ``n``."""
    return -(-n // LANES) * LANES


def fast_length(n: int) -> int:
    """The least number of points, ``n`` or more, that has no factor but the RADICES."""
    while True:
        left = n
        for radix in RADICES:
            while left % radix == 0:
                left //= radix
        if left == 1:
            return n
        n += 1


def lines(count: int) -> Lines:
    """The plan of transforms of ``count`` points, a product of RADICES."""
    radices, twiddles, left = [], [np.zeros(0)], count
    for radix in RADICES:
        while left % radix == 0:
            left //= radix
            radices.append(radix)
    left = count
    for radix in radices:
        angle = -2 * np.pi / left * np.outer(np.arange(left // radix), np.arange(1, radix))
        twiddles.append(np.stack([np.cos(angle), np.sin(angle)], -1).ravel())
        left //= radix
    return Lines(count, np.array(radices, np.int64), np.concatenate(twiddles).astype(np.float32))


@part
def stage(
    radix: int,
    m: int,
    stride: np.int64,
    source: NDArray[np.float32],
    at: int,
    step: np.int64,
    apart: np.int64,
    target: NDArray[np.float32],
    to: int,
    to_step: np.int64,
    to_apart: np.int64,
    twiddles: NDArray[np.float32],
    first: np.int64,
) -> None:
    """One stage of Stockham's method: ``m`` times ``stride`` butterflies."""
    gap, to_gap = step * stride * m, to_step * stride
    for p in range(m):
        own = first + 2 * (radix - 1) * p
        for q in range(stride):
            begin, end = at + step * (q + stride * p), to + to_step * (q + stride * radix * p)
            if radix == 4:
                _butterfly_4(source, begin, gap, apart, target, end, to_gap, to_apart, twiddles, own)
            elif radix == 2:
                _butterfly_2(source, begin, gap, apart, target, end, to_gap, to_apart, twiddles, own)
            elif radix == 3:
                _butterfly_3(source, begin, gap, apart, target, end, to_gap, to_apart, twiddles, own)
            else:
                _butterfly_5(source, begin, gap, apart, target, end, to_gap, to_apart, twiddles, own)


@part_with_way_in
def transform(
    plan: Lines,
    source: NDArray[np.float32],
    at: int,
    step: np.int64,
    apart: np.int64,
    target: NDArray[np.float32],
    to: int,
    to_step: np.int64,
    to_apart: np.int64,
    work: NDArray[np.float32],
) -> None:
    """Transform LANES lines: points ``step`` floats apart from ``at`` on in ``source``, imaginary parts ``apart``
    floats after real ones, to ``target`` likewise. ``work`` holds two lines of POINTs. With real and imaginary parts
    exchanged on both sides (``apart`` negative) it is the inverse, but for 1 / points."""
    stages, room, left = plan.radices.size, plan.points * POINT, plan.points
    stride, first = np.int64(1), ZERO
    for number in range(stages):
        radix = plan.radices[number]
        m = left // radix
        x, x_at, x_step, x_apart = work, (number & 1) * room, WIDE, SIDE
        y, y_at, y_step, y_apart = work, (1 - (number & 1)) * room, WIDE, SIDE
        if number == 0:
            x, x_at, x_step, x_apart = source, at, step, apart
        if number == stages - 1:
            y, y_at, y_step, y_apart = target, to, to_step, to_apart
        stage(radix, m, stride, x, x_at, x_step, x_apart, y, y_at, y_step, y_apart, plan.twiddles, first)
        first += 2 * (radix - 1) * m
        stride *= radix
        left = m


@inlined
def forward(
    plans: tuple[Lines, Lines, Lines],
    wide: int,
    high: int,
    space: NDArray[np.float32],
    rows: NDArray[np.float32],
    spectrum: NDArray[np.float32],
    work: NDArray[np.float32],
) -> None:
    """The spectrum of a window, flat as ``space`` is, which is overwritten. ``wide``, ``high``: nx', ny'. ``rows`` (two
    planes) and ``work`` are work arrays."""
    along_z, along_y, along_x = plans
    nz, nx, plane = along_z.points, along_x.points, high * wide
    whole, flat = nz * plane, nz * nx * high
    for y in range(along_y.points):
        for x in range(0, wide, LANES):
            at = y * wide + x
            transform(along_z, space, at, plane, whole, space, at, plane, whole, work)
    columns = work[2 * POINT * nx :]
    for z in range(nz):
        for x in range(0, wide, LANES):
            transform(along_y, space, z * plane + x, wide, whole, rows, x, wide, plane, work)
        for y in range(0, high, LANES):
            for x in range(0, wide, LANES):
                transpose(rows, y * wide + x, wide, columns, x * POINT, POINT)
                transpose(rows, plane + y * wide + x, wide, columns, x * POINT + LANES, POINT)
            transform(along_x, columns, ZERO, WIDE, SIDE, spectrum, z * nx * high + y, high, flat, work)


@part
def inverse_plane(
    plans: tuple[Lines, Lines, Lines],
    wide: int,
    spectrum: NDArray[np.float32],
    at: int,
    apart: int,
    high: int,
    begin: int,
    rows: NDArray[np.float32],
    work: NDArray[np.float32],
) -> None:
    """Of one plane of a spectrum from ``at`` on the inverse along x, as rows (2, ny', ``wide``): their first column is
    x = ``begin`` (which wraps around), times nx."""
    _, along_y, along_x = plans
    nx, plane = along_x.points, high * wide
    lines = 2 * POINT * nx
    columns = work[lines:]
    for y in range(0, along_y.points, LANES):
        transform(along_x, spectrum, at + apart + y, high, -apart, columns, SIDE, WIDE, -SIDE, work)
        turned = begin % nx
        for x in range(0, wide, LANES):
            for lane in range(LANES):
                from_, to = turned * POINT, lane * POINT
                for i in range(POINT):
                    work[to + i] = columns[from_ + i]
                turned = turned + 1 if turned + 1 < nx else 0
            transpose(work, 0, POINT, rows, y * wide + x, wide)
            transpose(work, LANES, POINT, rows, plane + y * wide + x, wide)


@inlined
def inverse(
    plans: tuple[Lines, Lines, Lines],
    wide: int,
    high: int,
    spectrum: NDArray[np.float32],
    rows: NDArray[np.float32],
    space: NDArray[np.float32],
    work: NDArray[np.float32],
) -> None:
    """The window of a spectrum, times nx ny nz."""
    along_z, along_y, along_x = plans
    nz, nx, plane = along_z.points, along_x.points, high * wide
    whole, flat = nz * plane, nz * nx * high
    for z in range(nz):
        inverse_plane(plans, wide, spectrum, z * nx * high, flat, high, ZERO, rows, work)
        for x in range(0, wide, LANES):
            to = z * plane + x
            transform(along_y, rows, plane + x, wide, -plane, space, whole + to, wide, -whole, work)
    for y in range(along_y.points):
        for x in range(0, wide, LANES):
            at = whole + y * wide + x
            transform(along_z, space, at, plane, -whole, space, at, plane, -whole, work)


@inlined
def inverse_near_zero(
    plans: tuple[Lines, Lines, Lines],
    high: int,
    half: NDArray[np.float32],
    radius: tuple[int, int, int],
    turns: NDArray[np.float32],
    rows: NDArray[np.float32],
    near: NDArray[np.float32],
    out: NDArray[np.float32],
    work: NDArray[np.float32],
) -> None:
    """Real values at places -r - 1 <= d <= r + 1 (``radius``: r along z, y, x) of the spectrum of a real window, times
    nx ny nz.

    ``half``: that spectrum's planes kz = 0 to nz // 2, the others being their conjugates. ``turns`` (2 rz + 3, kz, 2):
    cos and -sin of 2 pi kz dz / nz, times 2 for the planes that stand for two. ``near``: work array for (2, kz, 2 ry +
    3, wide), wide = 2 rx + 3 rounded up. ``out``: (2 rz + 3, 2 ry + 3, 2 rx + 3)."""
    along_z, along_y, along_x = plans
    _, ry, rx = radius
    depth, height, width = out.shape
    ny, nx, wide = along_y.points, along_x.points, (width + LANES - 1) // LANES * LANES
    planes, plane, flat = along_z.points // 2 + 1, high * wide, height * wide
    part = planes * flat
    for kz in range(planes):
        inverse_plane(plans, wide, half, kz * nx * high, planes * nx * high, high, -rx - 1, rows, work)
        for x in range(0, wide, LANES):
            columns = work[2 * POINT * ny :]
            transform(along_y, rows, plane + x, wide, -plane, columns, SIDE, WIDE, -SIDE, work)
            for dy in range(height):
                y, to = (dy - ry - 1) % ny, kz * flat + dy * wide + x
                for i in range(LANES):
                    near[to + i] = columns[y * POINT + i]
                    near[part + to + i] = columns[y * POINT + LANES + i]
    for dz in range(depth):
        rows[:flat] = np.float32(0)
        for kz in range(planes):
            real, imag = near[kz * flat : (kz + 1) * flat], near[part + kz * flat : part + (kz + 1) * flat]
            c, s = turns[dz, kz, 0], turns[dz, kz, 1]
            for i in range(flat):
                rows[i] += c * real[i] + s * imag[i]
        for dy in range(height):
            for dx in range(width):
                out[dz, dy, dx] = rows[dy * wide + dx]
