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
def find_peaks(correlation, displacement, peak_ratio, found):
    """Peaks of a batch of correlations.

    ``correlation``: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3), the search radius and one voxel more on each side; zero
    displacement in the middle. Writes ``displacement`` (batch, 3) as dx, dy, dz in voxels, ``peak_ratio`` (batch,) and
    ``found`` (batch,): False when there is no positive maximum within the search radius, or only a slope to its edge.
    """
    count, nz, ny, nx = correlation.shape
    for n in range(count):
        c = correlation[n]
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
        displacement[n, 0] = px - nx // 2 + gaussian_offset(c[pz, py, px - 1], best, c[pz, py, px + 1])
        displacement[n, 1] = py - ny // 2 + gaussian_offset(c[pz, py - 1, px], best, c[pz, py + 1, px])
        displacement[n, 2] = pz - nz // 2 + gaussian_offset(c[pz - 1, py, px], best, c[pz + 1, py, px])
        # without a second peak the ratio is bounded, not infinite
        peak_ratio[n] = best / max(second, np.float32(1e-3) * best)
        found[n] = best >= max(
            max(c[pz - 1, py, px], c[pz + 1, py, px]),
            max(max(c[pz, py - 1, px], c[pz, py + 1, px]), max(c[pz, py, px - 1], c[pz, py, px + 1])),
        )
