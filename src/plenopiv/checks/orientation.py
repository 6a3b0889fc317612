"""How images are stored: from a photographed letter F, or from a target that was moved in known directions.

A raw image whose microlenses are averaged away is a picture of what lies in the focal plane, one number for each
microlens. Its directions are those of the stored image: "upright" where columns grow with the object's +x and rows
with -y, "sensor" where it is turned by 180 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from plenopiv.errors import PlenoPIVError

Direction = Literal["right", "left", "up", "down"]
ON_UPRIGHT = {"right": (1, 0), "left": (-1, 0), "up": (0, -1), "down": (0, 1)}  # columns, rows

SMOOTH = 0.5  # standard deviation of the average, in pitches of the micro-images
BLOCKS = 3  # a pitch is averaged to so many pixels before: most of the time of large images
DIMMEST = 0.1  # of the white image's median: what is darker is left out of a quotient
LEAST_OVERLAP = 0.3  # of the picture, of both pictures at the largest shift looked for
SHORTEST = 0.7  # microlenses that a target must have moved by
ASKEW = 0.5  # component across the motion over the one along it
SAME = 0.5  # correlation of both pictures, one moved, from which on they show the same
REPEATED = 0.85  # and share of it that another shift must not reach
APART = 4  # pixels between two shifts that are not one

Matrix = tuple[tuple[int, int], tuple[int, int]]
STORED: dict[Matrix, str] = {  # columns of the matrix: where the image's columns and rows go (``checks.fit.TURNS``)
    ((1, 0), (0, 1)): "as it is",
    ((-1, 0), (0, -1)): "turned by 180 degrees",
    ((-1, 0), (0, 1)): "mirrored left to right",
    ((1, 0), (0, -1)): "mirrored top to bottom",
    ((0, 1), (-1, 0)): "turned by 90 degrees counter-clockwise",
    ((0, -1), (1, 0)): "turned by 90 degrees clockwise",
    ((0, 1), (1, 0)): "mirrored about a diagonal",
    ((0, -1), (-1, 0)): "mirrored about the other diagonal",
}


@dataclass(frozen=True)
class Moved:
    """By how much a picture moved: ``columns_px`` to the right and ``rows_px`` down, in pixels of the stored image;
    ``correlation`` of both pictures, one moved."""

    columns_px: float
    rows_px: float
    correlation: float


def picture_of(
    counts: NDArray, pitch_px: float, black_level: float = 0.0, white: NDArray | None = None
) -> tuple[NDArray[np.float32], float]:
    """A picture (rows, columns) of a raw image as it is stored, without its microlenses, and its pixels' width in px.

    ``white``: an image of a white field in counts, which evens out the light.
    """
    block = max(1, int(pitch_px / BLOCKS))
    sigma = SMOOTH * pitch_px / block
    step = max(1, round(pitch_px / block))
    light = _smooth(counts, block, sigma, black_level)
    if white is not None:
        even = _smooth(white, block, sigma, black_level)
        least = DIMMEST * float(np.median(even))
        light = np.where(
            even > least, light / np.maximum(even, max(least, 1e-6)), np.median(light / np.maximum(even, 1e-6))
        )
    return light[step // 2 :: step, step // 2 :: step].astype(np.float32), float(block * step)


def _smooth(counts: NDArray, block: int, sigma: float, black_level: float) -> NDArray[np.float32]:
    rows, columns = (n // block * block for n in counts.shape)
    cut = counts[:rows, :columns].reshape(rows // block, block, columns // block, block)
    return ndimage.gaussian_filter(cut.mean((1, 3), dtype=np.float32) - np.float32(black_level), sigma, mode="nearest")


def moved_between(a: NDArray, b: NDArray, pixel_px: float, names: Sequence[str] = ("a", "b")) -> Moved:
    """By how much the second of two pictures is moved; ``pixel_px``: width of their pixels in the stored image.

    Raises:
        PlenoPIVError: they do not show the same, the pattern repeats itself, or nothing moved.
    """
    both = f"{names[0]} and {names[1]}"
    values = _correlation(a, b)
    peaks = np.argwhere((values == ndimage.maximum_filter(values, 2 * APART + 1)) & (values > 0))
    if not peaks.size:
        raise PlenoPIVError(f"{both}: show nothing in common; are both of one target, well lit?")
    order = np.argsort(-values[tuple(peaks.T)])
    best = peaks[order[0]]
    height = float(values[tuple(best)])
    if height < SAME:
        raise PlenoPIVError(
            f"{both}: show nothing in common (correlation {height:.2f}, {SAME} is asked); move one target by less than"
            " a third of the field, in focus and well lit"
        )
    others = [float(values[tuple(p)]) for p in peaks[order[1:]]]
    if others and others[0] > REPEATED * height:
        raise PlenoPIVError(
            f"{both}: fit each other at several shifts (correlation {height:.2f} and {others[0]:.2f}): the pattern"
            " repeats itself, or has no detail along the motion; take random dots or a letter"
        )
    middle = (np.array(values.shape) - 1) / 2
    rows, columns = (float(v) for v in _refined(values, best) - middle)
    if max(abs(rows), abs(columns)) < SHORTEST:
        raise PlenoPIVError(
            f"{both}: the target did not move by a microlens ({abs(columns):.1f} along columns, {abs(rows):.1f} along"
            " rows); move it by several"
        )
    return Moved(columns * pixel_px, rows * pixel_px, height)


def _correlation(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Correlation coefficient of the overlap for each shift of ``b``, no shift in the middle; 0 with little overlap.

    Padfield 2012, Masked object registration in the Fourier domain, with whole rectangles for masks.
    """
    a, b = (np.asarray(p, float) - np.mean(p) for p in (a, b))
    one = np.ones(a.shape)

    def sums(p: NDArray, q: NDArray) -> NDArray[np.float64]:
        return signal.correlate(p, q, "full", "fft")

    count = np.maximum(np.rint(sums(one, one)), 1.0)
    of_b, of_a = sums(b, one), sums(one, a)
    product = sums(b, a) - of_a * of_b / count
    spread_b, spread_a = sums(b * b, one) - of_b**2 / count, sums(one, a * a) - of_a**2 / count
    spread = np.sqrt(np.maximum(spread_a, 0.0) * np.maximum(spread_b, 0.0))
    enough = (count >= LEAST_OVERLAP * a.size) & (spread > 1e-3 * spread.max())
    return np.where(enough, product / np.where(enough, spread, 1.0), 0.0)


def _refined(values: NDArray, at: NDArray) -> NDArray[np.float64]:
    """A maximum to parts of a pixel, by a parabola along each axis."""
    found = at.astype(float)
    for axis in (0, 1):
        if 0 < at[axis] < values.shape[axis] - 1:
            low, here, high = (values[tuple(at + k * np.eye(2, dtype=int)[axis])] for k in (-1, 0, 1))
            if (curved := low - 2 * here + high) < 0:
                found[axis] += 0.5 * (low - high) / curved
    return found


def how_stored(motions: Sequence[tuple[Direction, Moved]]) -> list[str]:
    """Ways in which images may be stored (names of ``checks.fit.TURNS``), in which a target that moved so, as seen from
    behind the camera, moves so in them; one where it moved along x and along y.

    Raises:
        PlenoPIVError: a motion along no axis of the image, or two that contradict each other.
    """
    fits = list(STORED)
    for direction, moved in motions:
        long, across = sorted((abs(moved.columns_px), abs(moved.rows_px)), reverse=True)
        if across > ASKEW * long:
            raise PlenoPIVError(
                f"moved {direction}: in the images by {moved.columns_px:+.0f} px along columns and"
                f" {moved.rows_px:+.0f} px along rows, which is no axis of them; move the target along one"
            )
        seen = np.array([moved.columns_px, moved.rows_px])
        fits = [m for m in fits if np.array(m) @ ON_UPRIGHT[direction] @ seen > ASKEW * long]
    if not fits:
        raise PlenoPIVError(
            "the motions contradict each other: no way of storing images shows them all; name them anew"
        )
    return [STORED[m] for m in fits]
