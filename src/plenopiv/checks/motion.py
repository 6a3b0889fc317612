"""How far particles move between two frames, before anything is reconstructed.

Refocused pictures through depth (``refocusing``) are a blurred volume: a particle is sharp at its own depth. Those of
two frames, without what is blurred, are correlated in three dimensions in a few large windows; displacements are
accurate to a fraction of a microlens, enough to choose windows and dt. In turbulent flow it is a mean over each window.
Along z it is underestimated where particles hardly move in the plane, because pictures also show the microlenses, which
stand still (of 2.3 voxels along z alone 0.6 are found, of 3.2 with 3.2 across 2.8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding
from plenopiv.lightfield import LightField
from plenopiv.refocusing import image_axes, refocused

STEPS = 2  # pictures' pixels per microlens
PLANES = 24  # at most
WINDOW = 14  # microlenses
CLEAR = 0.25  # correlation coefficient from which a peak is accepted; frames of two flows reach 0.16
SLOW = 0.7  # microlenses: what is more blurred is left out
REACH = 1.5  # half dead zones within which planes count less: they show the microlenses
EVERY = 3  # of the views; neighbours see nearly the same


@dataclass(frozen=True)
class Motion:
    """Displacements (n, 3) along x, y, z in mm from the first frame to the second at places (n, 3) in mm, of windows
    whose peaks were clear, and the median correlation coefficient of all peaks."""

    place_mm: NDArray[np.float64]
    displacement_mm: NDArray[np.float64]
    correlation: float


def motion(a: LightField, b: LightField, z_mm: tuple[float, float]) -> Motion:
    """Estimate how far the light of two frames moves in the depth ``z_mm``."""
    camera = a.layout.camera
    near, far = camera.dead_zone_mm()
    planes = int(np.clip(round((z_mm[1] - z_mm[0]) / (0.5 * (far - near))) + 1, 5, PLANES))
    z = np.linspace(*z_mm, planes)
    x, y = image_axes(camera, camera.lattice.pitch_mm / abs(camera.main_lens.magnification) / STEPS)
    y = y[::-1]
    first, second = (stack(lf, x, y, z) for lf in (a, b))
    places, moves, peaks = [], [], []
    for rows in parts(y.size):
        for columns in parts(x.size):
            move, peak = moved(first[:, rows, columns], second[:, rows, columns])
            peaks.append(peak)
            if peak >= CLEAR:
                places.append((x[columns].mean(), y[rows].mean(), z.mean()))
                moves.append((move[2] * (x[1] - x[0]), move[1] * (y[1] - y[0]), move[0] * (z[1] - z[0])))
    shape = (len(moves), 3)
    return Motion(np.reshape(places, shape), np.reshape(moves, shape), float(np.median(peaks)))


def stack(lightfield: LightField, x: NDArray, y: NDArray, z: NDArray, every: int = EVERY) -> NDArray[np.float64]:
    """Refocused pictures (z, y, x) from one view in ``every``, without their blurred part, dark where no view sees."""
    from scipy.ndimage import gaussian_filter

    views = range(0, lightfield.layout.views, every)
    pictures = np.nan_to_num(np.array([refocused(lightfield, float(depth), x, y, views) for depth in z], np.float64))
    pictures = np.sqrt(np.maximum(pictures, 0.0))  # a few bright particles count no more than the others
    weight = np.minimum(lightfield.layout.camera.dead_zones(z) / REACH, 1.0)[:, None, None] ** 2
    return weight * (pictures - gaussian_filter(pictures, (0, SLOW * STEPS, SLOW * STEPS)))


def parts(size: int) -> list[slice]:
    """Windows along one axis, as many as fit."""
    count = max(1, size // (WINDOW * STEPS))
    side = min(size, max(WINDOW * STEPS, size // count))
    return [slice(int(k), int(k) + side) for k in np.linspace(0, size - side, count)]


def moved(a: NDArray, b: NDArray) -> tuple[NDArray[np.float64], float]:
    """Displacement along the three axes from a to b, in cells to a fraction, and its correlation coefficient."""
    shape = [2 * n for n in a.shape]
    a, b = a - a.mean((1, 2), keepdims=True), b - b.mean((1, 2), keepdims=True)
    axes = (0, 1, 2)
    product = np.fft.irfftn(np.conj(np.fft.rfftn(a, shape, axes)) * np.fft.rfftn(b, shape, axes), shape, axes)
    product /= np.sqrt(np.sum(a**2) * np.sum(b**2)) or 1.0
    reach = [n // 2 for n in a.shape]
    near = product[np.ix_(*(np.arange(-n, n + 1) for n in reach))]
    for axis, n in enumerate(reach):  # over the overlap, or displacements come out too small
        overlap = 1 - np.abs(np.arange(-n, n + 1)) / a.shape[axis]
        near = near / overlap.reshape([-1 if k == axis else 1 for k in range(3)])
    peak = np.unravel_index(np.argmax(near), near.shape)
    move = np.array(peak, float) - reach
    for axis in range(3):
        k = peak[axis]
        if 0 < k < near.shape[axis] - 1:
            left, top, right = (float(near.take(k + d, axis)[tuple(np.delete(peak, axis))]) for d in (-1, 0, 1))
            curve = left - 2 * top + right
            move[axis] += 0.5 * (left - right) / curve if curve < 0 else 0.0
    return move, float(near[peak])


def finding(found: Motion, voxel_mm: tuple[float, float, float], limit: NDArray[np.float64]) -> Finding:
    """The finding on displacement; ``limit``: the largest one that the first pass finds, voxels along x, y, z."""
    if not len(found.displacement_mm):
        return Finding(
            "displacement",
            "warning",
            "the two frames show no common displacement",
            found.correlation,
            advice="a smaller dt, a thinner light sheet; are these two frames of one flow? plenopiv preview tells more",
        )
    voxels = np.abs(found.displacement_mm) / voxel_mm
    largest, middle = np.percentile(voxels, 90, axis=0), np.median(found.displacement_mm / voxel_mm, axis=0)
    moves = ", ".join(f"{v:+.1f}" for v in middle)
    words = f"particles move by about ({moves}) voxels along (x, y, z)"
    over = float(np.max(largest / limit))
    if over > 1.0:
        k = int(np.argmax(largest / limit))
        words = f"{words}, up to {largest[k]:.0f} along {'xyz'[k]}, where the first windows find {limit[k]:.0f}"
        advice = "larger first windows (correlation.windows), or a smaller dt"
        return Finding("displacement-too-large", "warning", words, over, "of the search range", advice)
    return Finding("displacement", "good", words, float(np.max(np.abs(middle))), "voxels")
