"""Light that stays where it is: what frames of different pairs have in common.

Particles of different pairs are others, in other places. Frames without their slowly varying part and over their local
contrast are correlated pixel by pixel, at no shift, and at shifts by some microlenses. The second is what light sheet,
borders of the volume and the microlenses' rims leave in common. Of good recordings the first exceeds it by 0.02 to 0.06
(0.25 to 2 particles per microlens, 8 to 28 pixels across one) and by 0.11 at 6 per microlens; particles stuck to a
window, half as bright as the others and as many, make it 0.23 to 0.31.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks.findings import Finding

IN_COMMON = 0.13  # correlation above that at other places
FRAMES = 4  # that are compared
LIT = 0.7  # of the white image's bright pixels: pixels that are compared
SLOW = 1.2  # pitches: what varies more slowly is left out
NEAR, FAR = 1.5, 5.0  # pitches: shifts that are compared
SHIFTS = 6

Image = NDArray[np.float32]


def in_common(frames: Sequence[NDArray], white: NDArray, camera: PlenopticCamera) -> float:
    """Correlation of frames of different pairs beyond that at other places; ``camera`` with the white image's lattice,
    images upright, in counts."""
    black, pitch = np.float32(camera.sensor.black_level), camera.image_pitch_px
    light = white - black
    bright = np.percentile(light, 90)
    lit = light > LIT * bright
    gain = np.maximum(light / bright, LIT)
    patterns = [_pattern(np.maximum(frame - black, 0) / gain, lit, SLOW * pitch) for frame in frames[:FRAMES]]
    here, *there = (_correlation(patterns, lit, shift) for shift in [(0, 0), *_shifts(camera)])
    return here - float(np.mean(there))


def finding(share: float) -> Finding | None:
    """A finding where frames of different pairs have light in common."""
    if share < IN_COMMON:
        return None
    return Finding(
        "static-light",
        "warning",
        f"frames of different pairs have {100 * share:.0f} % of their contrast in common, where particles have none: "
        "particles or dirt on a window, or reflections",
        100 * share,
        "%",
        'clean the windows, or name images of the static light in recording.background, or "minimum" with many pairs; '
        "vectors near it are pulled toward zero",
    )


def _pattern(light: NDArray, lit: NDArray[np.bool_], sigma_px: float) -> Image:
    """Light over its local contrast without its local mean, 0 where a pixel is not ``lit``."""
    from scipy.ndimage import gaussian_filter

    smooth = partial(gaussian_filter, sigma=sigma_px)
    weight = np.maximum(smooth(lit.astype(np.float32)), np.float32(1e-3))
    root = np.where(lit, np.sqrt(light), 0).astype(np.float32)  # a few bright particles count no more than the others
    rest = np.where(lit, root - smooth(root) / weight, np.float32(0))
    return rest / np.maximum(np.sqrt(smooth(rest**2) / weight), np.float32(1e-3))


def _correlation(patterns: Sequence[Image], lit: NDArray[np.bool_], shift: tuple[int, int]) -> float:
    """Mean product of two patterns, one of them shifted, over all two."""
    count = max(int(np.count_nonzero(lit & np.roll(lit, shift, (0, 1)))), 1)
    products = [float(np.vdot(a, np.roll(b, shift, (0, 1)))) / count for a, b in combinations(patterns, 2)]
    return float(np.mean(products))


def _shifts(camera: PlenopticCamera) -> list[tuple[int, int]]:
    """Shifts (rows, columns) in whole pixels that are nearest to whole microlenses."""
    reach = int(FAR) + 1
    lattice = camera.lattice
    turn = lattice.rotation_rad + np.pi / (3 if lattice.kind == "hexagonal" else 2)
    i, j = (index.ravel() for index in np.mgrid[0 : reach + 1, -reach : reach + 1])
    x = camera.image_pitch_px * (i * np.cos(lattice.rotation_rad) + j * np.cos(turn))
    y = camera.image_pitch_px * (i * np.sin(lattice.rotation_rad) + j * np.sin(turn))
    off = np.hypot(x - np.rint(x), y - np.rint(y))
    length = np.hypot(x, y) / camera.image_pitch_px
    off[(length < NEAR) | (length > FAR)] = np.inf
    return [(-round(y[k]), round(x[k])) for k in np.argsort(off)[:SHIFTS]]
