"""Dots of a calibration board in an image: where they are, and which is which.

The board: bright round dots on a dark ground, on a square grid, in a plane z = constant. The dot on the grid's origin
is larger than the others; from it, columns grow along +x and rows along -y, as in every upright image, so the camera
may be turned about its line of sight by less than 45 degrees, as the grid appears in the image.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

CONTRAST = 10.0  # of bright over dark, in standard deviations of the darker half: noise alone has 7
BRIGHTEST = 99.95  # percent: a few dots are enough
FEWEST_DOTS = 9
FEWEST_PIXELS = 6  # of a dot
RIM_PX = 2  # around a dot, that its centre is taken over
SMALLEST, LARGEST = 0.3, 4.0  # area of a dot, in those of the median one
ORIGIN = 1.4  # area of the origin's dot in those of the next largest, at least
ACROSS = 0.75  # sine of the angle between steps along x and y, at least; a diagonal's is .71, a tilted board's .9
NEAR = 0.3  # of the grid's step: largest distance of a dot from where its neighbours predict it


@dataclass(frozen=True)
class Dots:
    """Dots of one image. ``pixel`` (n, 2): (column, row) of their centres; ``number`` (n, 2): (i, j) on the grid, along
    the board's x and y; the origin is (0, 0)."""

    pixel: NDArray[np.float64]
    number: NDArray[np.int64]


def find_dots(image: NDArray, name: str = "board image") -> Dots:
    """The dots of a board in an upright image (rows, columns).

    A centre is the mean place of the light above the dark ground, over the dot and a rim of two pixels. Dots at the
    border of the image are left out, and those that no chain of neighbours joins to the origin's.

    Raises PlenoPIVError, ``name`` first, where there are no dots, none stands out as the origin's, or fewer than half
    of them are on its grid.
    """
    pixel, area = _blobs(np.asarray(image, np.float64), name)
    largest, second = np.argsort(area)[[-1, -2]]
    if area[largest] < ORIGIN * area[second]:
        raise PlenoPIVError(
            f"{name}: no dot is clearly larger than the others, so the grid has no origin; use a board whose dot at "
            "x = y = 0 is larger, and keep it in the image"
        )
    number = number_dots(pixel, int(largest))
    if len(number) < FEWEST_DOTS:
        raise PlenoPIVError(
            f"{name}: only {len(number)} dots lie on one grid with the largest; check that the board is flat, lit "
            "evenly and not turned by 45 degrees"
        )
    if 2 * len(number) < len(pixel):
        raise PlenoPIVError(
            f"{name}: of {len(pixel)} dots only {len(number)} lie on one grid with the largest; check that the camera "
            "is turned by less than 45 degrees about its line of sight, and that nothing else in the image is bright"
        )
    of = np.array(sorted(number))
    return Dots(pixel[of], np.array([number[n] for n in of]))


def _blobs(image: NDArray[np.float64], name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (n, 2) as (column, row) and areas (n,) of bright spots away from the border."""
    from scipy import ndimage

    dark, bright = np.percentile(image, [20, BRIGHTEST])
    ground = image[image <= np.median(image)]
    if not bright - dark > CONTRAST * max(float(ground.std()), 1e-6 * abs(bright)):
        raise PlenoPIVError(f"{name}: no dots; give an image of the board, bright dots on a dark ground")
    label, found = ndimage.label(image > 0.5 * (dark + bright))
    numbers = np.arange(1, found + 1)
    area = ndimage.sum_labels(np.ones_like(image), label, numbers) if found else np.zeros(0)
    boxes = ndimage.find_objects(label)
    rows, columns = image.shape
    whole = np.array([
        r.start > RIM_PX and c.start > RIM_PX and r.stop < rows - RIM_PX and c.stop < columns - RIM_PX for r, c in boxes
    ], bool)  # fmt: skip
    sound = whole & (area >= FEWEST_PIXELS)
    typical = float(np.median(area[sound])) if sound.any() else np.nan
    sound &= (area > SMALLEST * typical) & (area < LARGEST * typical)
    if sound.sum() < FEWEST_DOTS:
        raise PlenoPIVError(
            f"{name}: no board: {int(sound.sum())} dots, {FEWEST_DOTS} or more are needed; give an image of the board, "
            "bright dots on a dark ground, larger than three pixels"
        )
    grown = ndimage.grey_dilation(label, size=2 * RIM_PX + 1)
    light = image - np.median(image[grown == 0])
    centres = np.array(ndimage.center_of_mass(light, grown, numbers[sound]))
    return centres[:, ::-1], area[sound]


def number_dots(pixel: NDArray[np.float64], origin: int) -> dict[int, tuple[int, int]]:
    """Which dots (column, row) of ``pixel`` (n, 2) are on one grid with the dot ``origin``: dot -> (i, j), rightward
    and upward. A neighbour is searched one step on, the step being that found beside it."""
    from scipy.spatial import cKDTree

    tree = cKDTree(pixel)
    steps = _first_steps(pixel, origin, tree)
    if steps is None:
        return {origin: (0, 0)}
    number, taken = {origin: (0, 0)}, {(0, 0)}
    queue = deque([(origin, steps)])
    while queue:
        dot, (along_x, along_y) = queue.popleft()
        i, j = number[dot]
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            step = di * along_x + dj * along_y
            distance, other = tree.query(pixel[dot] + step)
            if distance > NEAR * np.hypot(*step) or int(other) in number or (i + di, j + dj) in taken:
                continue
            found = pixel[other] - pixel[dot]
            local = (di * found, along_y) if di else (along_x, dj * found)
            number[int(other)] = (i + di, j + dj)
            taken.add((i + di, j + dj))
            queue.append((int(other), local))
    return number


def _first_steps(pixel: NDArray[np.float64], origin: int, tree: cKDTree) -> tuple[NDArray, NDArray] | None:
    """Steps (column, row) along +x and +y at the origin: the shortest to the nearest eight dots and the shortest across
    it, either way, so that one dot beside the origin's may be missing; of the four ways round that which is
    most to the right and upward."""
    _, near = tree.query(pixel[origin], k=9)
    off = pixel[near[1:]] - pixel[origin]
    off = off[np.argsort(np.hypot(*off.T))]
    first = off[0]
    across = np.abs(first[0] * off[:, 1] - first[1] * off[:, 0]) / (np.hypot(*first) * np.hypot(*off.T))
    if not (across > ACROSS).any():
        return None
    second = off[np.argmax(across > ACROSS)]
    if first[0] * second[1] > first[1] * second[0]:  # rows grow downward: y is the quarter turn from x toward smaller
        second = -second
    ways = ((first, second), (second, -first), (-first, -second), (-second, first))
    return max(ways, key=lambda way: way[0][0] / np.hypot(*way[0]) - way[1][1] / np.hypot(*way[1]))
