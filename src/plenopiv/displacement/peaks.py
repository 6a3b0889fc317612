"""The highest peak of a correlation, its sub-voxel position, and how far it stands above the second."""

from __future__ import annotations

from math import log

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.overlap import PLAIN
from plenopiv.kernels import kernel, part

LEAST = 0.02  # determinant of a peak's curvatures over the product of those along the axes
FARTHEST = 1.0  # voxels from the highest voxel to the maximum along an axis; slanted peaks reach more than half a voxel
Z, Y, X = np.int64(0), np.int64(1), np.int64(2)  # as arguments: a plain number is a type of its own
PEAK_RADIUS = 3  # voxels: a second peak this close on every axis is the flank of the first


@part
def gaussian_offset(left: float, centre: float, right: float) -> float:
    """Position of the maximum of a Gaussian through three neighbours, relative to the middle one (voxels).

    Willert & Gharib (1991). A parabola takes over when a neighbour is not positive and a logarithm would not exist;
    values are limited to +-0.5, which only a plateau or a slope can exceed.
    """
    if left > 0.0 and centre > 0.0 and right > 0.0:
        left, centre, right = log(left), log(centre), log(right)
    curvature = 2.0 * centre - left - right
    if curvature <= 0.0:
        return 0.0
    return min(0.5, max(-0.5, 0.5 * (right - left) / curvature))


@part
def curvature(left: float, centre: float, right: float) -> float:
    """Minus the second derivative of the peak (of its logarithm, as in ``gaussian_offset``) at the middle of three
    neighbours."""
    if left > 0.0 and centre > 0.0 and right > 0.0:
        left, centre, right = log(left), log(centre), log(right)
    return 2.0 * centre - left - right


@part
def twist(r: NDArray[np.float32], z: int, y: int, x: int, one: int, other: int) -> float:
    """Minus the mixed second derivative of log r at a voxel, from the four corners in the plane of two axes (0 = z);
    0 where one of them is not positive."""
    total = 0.0
    for side in range(4):
        s, t = 1 - 2 * (side // 2), 1 - 2 * (side % 2)
        value = r[
            z + s * (one == 0) + t * (other == 0),
            y + s * (one == 1) + t * (other == 1),
            x + s * (one == 2) + t * (other == 2),
        ]
        if value <= 0.0:
            return 0.0
        total -= s * t * log(value) / 4.0
    return total


@part
def untilted(r: NDArray[np.float32], z: int, y: int, x: int, matrix: NDArray[np.float64]) -> None:
    """Write the ``matrix`` (3, 3), x y z, that takes the peak offsets along the three axes to the offset of the
    maximum.

    Off the camera's axis, particles are elongated along slanted lines of sight, so peaks are Gaussians whose principal
    axes are not the grid's. With H the matrix of curvatures (minus second derivatives of log r), D its diagonal and d
    the offset of the maximum, sections along the grid's axes have their maxima at D^-1 H d. The matrix is the inverse,
    H^-1 D. Where noise leaves H hardly positive definite, its off-diagonal terms are reduced until the determinant of
    D^-1 H is LEAST.
    """
    a = curvature(r[z, y, x - 1], r[z, y, x], r[z, y, x + 1])
    b = curvature(r[z, y - 1, x], r[z, y, x], r[z, y + 1, x])
    c = curvature(r[z - 1, y, x], r[z, y, x], r[z + 1, y, x])
    for i in range(3):
        for j in range(3):
            matrix[i, j] = 1.0 if i == j else 0.0
    if a <= 0.0 or b <= 0.0 or c <= 0.0:
        return
    if min(r[z, y, x - 1], r[z, y, x + 1], r[z, y - 1, x], r[z, y + 1, x], r[z - 1, y, x], r[z + 1, y, x]) <= 0.0:
        return  # curvatures there are not of log r, and in its unit
    xy, xz, yz = twist(r, z, y, x, Y, X), twist(r, z, y, x, Z, X), twist(r, z, y, x, Z, Y)
    while True:
        p, q, s = xy * xy / (a * b), xz * xz / (a * c), yz * yz / (b * c)
        determinant = 1.0 - p - q - s + 2.0 * xy * xz * yz / (a * b * c)
        if determinant >= LEAST and max(p, max(q, s)) < 1.0:
            break
        xy, xz, yz = 0.9 * xy, 0.9 * xz, 0.9 * yz
    d = 1.0 / determinant
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = d * (1.0 - s), d * (1.0 - q), d * (1.0 - p)
    matrix[0, 1], matrix[0, 2] = d * (xz * yz / (a * c) - xy / a), d * (xy * yz / (a * b) - xz / a)
    matrix[1, 0], matrix[1, 2] = d * (xz * yz / (b * c) - xy / b), d * (xy * xz / (a * b) - yz / b)
    matrix[2, 0], matrix[2, 1] = d * (xy * yz / (b * c) - xz / c), d * (xy * xz / (a * c) - yz / c)


@kernel
def find_peaks(
    correlation: NDArray[np.float32],
    gain: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    displacement: NDArray[np.float64],
    peak_ratio: NDArray[np.float32],
    found: NDArray[np.bool_],
    place: NDArray[np.int64],
    untilt: NDArray[np.float64],
    powers: NDArray[np.float64],
    power: NDArray[np.float64],
) -> None:
    """Peaks of a batch of correlations: searched without ``gain``, their positions fitted with it.

    The gain corrects for the overlap of the windows, without which peaks are biased toward zero. It grows outward and
    raises chance peaks there, so the highest peak is searched without it.
    ``correlation``: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3), the search radius and one voxel more on each side; zero
    displacement in the middle. ``gain``: factors along z, y, x, (batch, 2 r + 3) each, or one for all (1, ...). Writes
    ``displacement`` (batch, 3) as dx, dy, dz in voxels, ``peak_ratio`` (batch,), highest over second highest
    correlation, and ``found`` (batch,): False when there is no positive maximum within the search radius, or only a
    slope to its edge. ``place`` (batch, 3): dx, dy, dz of the voxel about which the peak was
    fitted; ``untilt`` (batch, 3, 3): see ``untilted``.
    The gain along each axis is raised to a power by the peak's curvature there: ``powers`` (3, knots), x y z, of
    ``overlap.powers``, writes ``power`` (batch, 3).
    """
    count, nz, ny, nx = correlation.shape
    r = np.empty((3, 3, 3), correlation.dtype)
    raised = np.ones((3, max(nz, max(ny, nx))), np.float32)
    for n in range(count):
        c = correlation[n]
        best, pz, py, px = np.float32(0.0), np.int64(-1), np.int64(0), np.int64(0)
        for k in range(1, nz - 1):
            for j in range(1, ny - 1):
                for i in range(1, nx - 1):
                    value = c[k, j, i]
                    if value > best:
                        best, pz, py, px = value, np.int64(k), np.int64(j), np.int64(i)
        if pz < 0:
            peak_ratio[n] = 0.0
            found[n] = False
            for axis in range(3):
                displacement[n, axis], place[n, axis], power[n, axis] = 0.0, 0, 1.0
                untilt[n, axis, 0] = untilt[n, axis, 1] = untilt[n, axis, 2] = 0.0
            continue
        second = np.float32(0.0)
        for k in range(1, nz - 1):
            for j in range(1, ny - 1):
                for i in range(1, nx - 1):
                    value = c[k, j, i]
                    if value > second and max(abs(k - pz), max(abs(j - py), abs(i - px))) > PEAK_RADIUS:
                        second = value
        # without a second peak the ratio is bounded, not infinite
        peak_ratio[n] = best / max(second, np.float32(1e-3) * best)
        found[n] = True
        for axis in range(3):
            for side in (-1, 1):
                found[n] &= best >= c[pz + side * (axis == 0), py + side * (axis == 1), px + side * (axis == 2)]
        gz, gy, gx = gain
        own = gz[min(n, len(gz) - 1)], gy[min(n, len(gy) - 1)], gx[min(n, len(gx) - 1)]
        raise_gain(c, own, pz, py, px, powers, power[n], raised)
        pz, py, px = _nearest_top(c, raised, pz, py, px)
        place[n, 0], place[n, 1], place[n, 2] = px - nx // 2, py - ny // 2, pz - nz // 2
        for k in range(3):
            for j in range(3):
                for i in range(3):
                    at = pz + k - 1, py + j - 1, px + i - 1
                    r[k, j, i] = c[at] * raised[2, at[0]] * raised[1, at[1]] * raised[0, at[2]]
        untilted(r, Y, Y, Y, untilt[n])
        middle = r[1, 1, 1]
        x, y = gaussian_offset(r[1, 1, 0], middle, r[1, 1, 2]), gaussian_offset(r[1, 0, 1], middle, r[1, 2, 1])
        z = gaussian_offset(r[0, 1, 1], middle, r[2, 1, 1])
        for axis in range(3):
            off = untilt[n, axis, 0] * x + untilt[n, axis, 1] * y + untilt[n, axis, 2] * z
            displacement[n, axis] = place[n, axis] + min(FARTHEST, max(-FARTHEST, off))


@part
def power_for(row: NDArray[np.float64], left: float, centre: float, right: float) -> float:
    """The power of ``overlap.powers`` for a peak and its neighbours; 1 where one of them is not positive and the
    curvature would have a unit."""
    if not (left > 0.0 and centre > 0.0 and right > 0.0):
        return 1.0
    knots, bend = row.size - PLAIN, curvature(left, centre, right)
    at = (1.0 / bend - row[0]) * row[1] if bend > 0.0 else float(knots)
    at = min(max(at, 0.0), knots - 1.0)
    below = min(int(at), knots - 2)
    return row[PLAIN + below] + (at - below) * (row[PLAIN + below + 1] - row[PLAIN + below])


@part
def raise_gain(
    c: NDArray[np.float32],
    gain: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    z: int,
    y: int,
    x: int,
    powers: NDArray[np.float64],
    power: NDArray[np.float64],
    raised: NDArray[np.float32],
) -> None:
    """The gain along x, y, z, raised to the powers that suit the peak at a voxel: ``raised`` (3, n)."""
    nz, ny, nx = c.shape  # the middle of each is no displacement
    power[0] = power_for(powers[0], c[z, y, x - 1], c[z, y, x], c[z, y, x + 1])
    power[1] = power_for(powers[1], c[z, y - 1, x], c[z, y, x], c[z, y + 1, x])
    power[2] = power_for(powers[2], c[z - 1, y, x], c[z, y, x], c[z + 1, y, x])
    for i in range(nx):
        raised[0, i] = gain[2][i] ** power[0]
    for j in range(ny):
        raised[1, j] = gain[1][j] ** power[1]
    for k in range(nz):
        raised[2, k] = gain[0][k] ** power[2]


@part
def _nearest_top(
    c: NDArray[np.float32], raised: NDArray[np.float32], pz: int, py: int, px: int
) -> tuple[int, int, int]:
    """The local maximum of c times the gain that is reached uphill from a voxel, within the search radius. The gain may
    move the maximum to a neighbouring voxel."""
    while True:
        best, tz, ty, tx = c[pz, py, px] * raised[2, pz] * raised[1, py] * raised[0, px], pz, py, px
        for axis in range(3):
            for side in (-1, 1):
                z, y, x = pz + side * (axis == 0), py + side * (axis == 1), px + side * (axis == 2)
                if 0 < z < c.shape[0] - 1 and 0 < y < c.shape[1] - 1 and 0 < x < c.shape[2] - 1:
                    value = c[z, y, x] * raised[2, z] * raised[1, y] * raised[0, x]
                    if value > best:
                        best, tz, ty, tx = value, z, y, x
        if tz == pz and ty == py and tx == px:
            return pz, py, px
        pz, py, px = tz, ty, tx
