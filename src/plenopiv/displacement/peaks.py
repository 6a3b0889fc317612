"""The highest peak of a correlation, its sub-voxel position, and how far it stands above the second."""

from __future__ import annotations

from math import log

import numpy as np

from plenopiv.kernels import kernel

PEAK_RADIUS = 3  # voxels: a second peak this close on every axis is the flank of the first


@kernel(nogil=True)
def gaussian_offset(left, centre, right):
    """Where a Gaussian through three neighbours has its top, relative to the middle one (voxels).

    Willert & Gharib (1991). A parabola takes over when a neighbour is not positive and a logarithm would not exist;
    values are limited to +-0.5, which only a plateau or a slope can exceed.
    """
    if left > 0.0 and centre > 0.0 and right > 0.0:
        left, centre, right = log(left), log(centre), log(right)
    curvature = 2.0 * centre - left - right
    if curvature <= 0.0:
        return 0.0
    return min(0.5, max(-0.5, 0.5 * (right - left) / curvature))


@kernel(nogil=True)
def find_peaks(correlation, gain, displacement, peak_ratio, found):
    """Peaks of a batch of correlations: looked for as they are, placed after multiplication by ``gain``.

    The gain makes up for the overlap of the windows, without which peaks are pulled toward zero. It grows outward and
    raises chance peaks there, so which peak is highest is asked without it.
    ``correlation``: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3), the search radius and one voxel more on each side; zero
    displacement in the middle. ``gain``: the same shape, or one for all (1, ...). Writes ``displacement`` (batch, 3) as
    dx, dy, dz in voxels, ``peak_ratio`` (batch,), highest over second highest correlation, and ``found`` (batch,):
    False when there is no positive maximum within the search radius, or only a slope to its edge.
    """
    count, nz, ny, nx = correlation.shape
    for n in range(count):
        c, g = correlation[n], gain[n if gain.shape[0] > 1 else 0]
        best, pz, py, px = np.float32(0.0), -1, 0, 0
        for k in range(1, nz - 1):
            for j in range(1, ny - 1):
                for i in range(1, nx - 1):
                    if c[k, j, i] > best:
                        best, pz, py, px = c[k, j, i], k, j, i
        if pz < 0:
            displacement[n, :] = 0.0
            peak_ratio[n] = 0.0
            found[n] = False
            continue
        second = np.float32(0.0)
        for k in range(1, nz - 1):
            for j in range(1, ny - 1):
                for i in range(1, nx - 1):
                    apart = abs(k - pz) > PEAK_RADIUS or abs(j - py) > PEAK_RADIUS or abs(i - px) > PEAK_RADIUS
                    if apart and c[k, j, i] > second:
                        second = c[k, j, i]
        # without a second peak the ratio is bounded, not infinite
        peak_ratio[n] = best / max(second, np.float32(1e-3) * best)
        found[n] = best >= max(
            max(c[pz - 1, py, px], c[pz + 1, py, px]),
            max(max(c[pz, py - 1, px], c[pz, py + 1, px]), max(c[pz, py, px - 1], c[pz, py, px + 1])),
        )
        pz, py, px = _nearest_top(c, g, pz, py, px)
        top = c[pz, py, px] * g[pz, py, px]
        displacement[n, 0] = (
            px
            - nx // 2
            + gaussian_offset(c[pz, py, px - 1] * g[pz, py, px - 1], top, c[pz, py, px + 1] * g[pz, py, px + 1])
        )
        displacement[n, 1] = (
            py
            - ny // 2
            + gaussian_offset(c[pz, py - 1, px] * g[pz, py - 1, px], top, c[pz, py + 1, px] * g[pz, py + 1, px])
        )
        displacement[n, 2] = (
            pz
            - nz // 2
            + gaussian_offset(c[pz - 1, py, px] * g[pz - 1, py, px], top, c[pz + 1, py, px] * g[pz + 1, py, px])
        )


@kernel(nogil=True)
def _nearest_top(c, g, pz, py, px):
    """The maximum of c g uphill from a voxel, within the search radius: where the gain moves a top to a neighbour."""
    while True:
        best, tz, ty, tx = c[pz, py, px] * g[pz, py, px], pz, py, px
        for axis in range(3):
            for side in (-1, 1):
                z, y, x = pz + side * (axis == 0), py + side * (axis == 1), px + side * (axis == 2)
                inside = 0 < z < c.shape[0] - 1 and 0 < y < c.shape[1] - 1 and 0 < x < c.shape[2] - 1
                if inside and c[z, y, x] * g[z, y, x] > best:
                    best, tz, ty, tx = c[z, y, x] * g[z, y, x], z, y, x
        if tz == pz and ty == py and tx == px:
            return pz, py, px
        pz, py, px = tz, ty, tx
