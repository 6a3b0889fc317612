"""Dots of a target in a light field, roughly: where each is in lens space, and how bright.

All views are added up at one depth after the other (``refocusing``); where the picture has most contrast, the target
is. There dots are the bright spots of a dot's size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.target.board import Board
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField
from plenopiv.refocusing import image_axes, refocused

VIEWS = 25  # that are added up while the depth is searched
DEPTHS = 4  # tried in half a dead zone
FEWEST = 9  # dots of a plane
BRIGHT = 0.35  # of a dot's height: what is higher is one
CLOSEST = 0.6  # of the pitch, between two dots
CONTRAST = 6.0  # of a dot over the ground, in standard deviations of the ground


@dataclass(frozen=True)
class Spots:
    """``place_mm`` (n, 3): of bright spots in lens space, all at one z. ``light`` (n,): sum of the picture over each,
    above the ground, in those of the median spot."""

    place_mm: NDArray[np.float64]
    light: NDArray[np.float64]


def find_spots(lightfield: LightField, board: Board, reach_mm: float, name: str) -> Spots:
    """The bright spots of a target somewhere between z = -reach_mm and reach_mm of lens space.

    Raises:
        PlenoPIVError: ``name`` first, there are fewer than nine.
    """
    camera = lightfield.layout.camera
    regular = camera.with_lattice(replace(camera.lattice, map=None))  # near enough to find them, and quicker
    lightfield = replace(lightfield, layout=replace(lightfield.layout, camera=regular))
    x, y = image_axes(camera, min(camera.lattice.pitch_mm / abs(camera.main_lens.magnification), board.dot_mm) / 2)
    z = _depth(lightfield, reach_mm)
    picture = np.nan_to_num(refocused(lightfield, z, x, y))
    spots = _spots(picture, x[1] - x[0], board)
    if spots is None or len(spots[0]) < FEWEST:
        found = 0 if spots is None else len(spots[0])
        raise PlenoPIVError(
            f"{name}: {found} dots of a target found, {FEWEST} or more are needed; give an image of white dots on a "
            "dark ground, and check calibration.pitch_mm and dot_mm"
        )
    at, light = spots
    place = np.column_stack([
        np.interp(at[:, 1], np.arange(x.size), x), np.interp(at[:, 0], np.arange(y.size), y), np.full(len(at), z)
    ])  # fmt: skip
    return Spots(place, light / np.median(light))


def _depth(lightfield: LightField, reach_mm: float) -> float:
    """Where a picture of all views has most contrast."""
    layout = lightfield.layout
    near, far = layout.camera.dead_zone_mm()
    step = (far - near) / 2 / DEPTHS
    views = range(0, layout.views, max(1, layout.views // VIEWS))
    x, y = image_axes(layout.camera)

    def contrast(z: float) -> float:
        picture = refocused(lightfield, z, x, y, views)
        return float(np.nanvar(picture)) if np.isfinite(picture).any() else 0.0

    coarse = np.arange(-reach_mm, reach_mm + step, (far - near) / 2)
    best = float(coarse[np.argmax([contrast(z) for z in coarse])])
    fine = best + step * np.arange(-DEPTHS, DEPTHS + 1)
    return float(fine[np.argmax([contrast(z) for z in fine])])


def _spots(picture: NDArray, step_mm: float, board: Board) -> tuple[NDArray, NDArray] | None:
    """Places (n, 2) of the spots' centres, rows and columns of ``picture``, and the light (n,) of each; None where
    nothing stands out."""
    from scipy import ndimage

    radius, apart = board.dot_mm / 2 / step_mm, board.pitch_mm / step_mm
    smooth = ndimage.gaussian_filter(picture.astype(float), max(radius / 2, 0.7))
    ground = ndimage.gaussian_filter(ndimage.minimum_filter(smooth, int(apart) | 1), apart / 2)
    height = smooth - ground
    highest = ndimage.maximum_filter(height, int(CLOSEST * apart) | 1) == height
    margin = int(np.ceil(radius))
    highest[:margin] = highest[-margin:] = False
    highest[:, :margin] = highest[:, -margin:] = False
    at = np.argwhere(highest & (height > 0))
    if not len(at):
        return None
    heights = height[tuple(at.T)]
    typical = float(np.median(heights[heights > BRIGHT * np.percentile(heights, 95)]))
    at = at[heights > BRIGHT * typical]
    low, ground_level = np.percentile(height, [5, 30])  # below most dots, however densely they stand
    if typical - ground_level < CONTRAST * max(float(ground_level - low) / 1.12, 1e-9):
        return None
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    light, centre = np.empty(len(at)), np.empty((len(at), 2))
    around = int(0.45 * apart)
    for n, (r, c) in enumerate(at):
        box = slice(max(r - around, 0), r + around + 1), slice(max(c - around, 0), c + around + 1)
        near = np.hypot(rows[box] - r, columns[box] - c) <= around
        values = np.where(near, np.maximum(picture[box] - ground[box], 0), 0)
        light[n] = values.sum()
        centre[n] = (values * rows[box]).sum() / light[n], (values * columns[box]).sum() / light[n]
    return centre, light
