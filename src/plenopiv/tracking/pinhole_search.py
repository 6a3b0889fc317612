"""Where lines of sight to bright spots cross: particles of several pinhole cameras from their residual images.

Each camera's residual, in standard deviations of its pixels, is summed over a particle's image, so that noise has 1:
bright spots are its local maxima above LEAST. The line of sight of each spot of the first camera is followed through
the volume in steps of a pixel of the camera where it moves most; where every other camera has a spot near its image, a
particle may be. Its place is where all lines of sight come nearest to each other (least squares in the
pixels); it counts where these differ by at most APART pixels. Of places that share a spot the best alone is returned:
the rest is looked for again once these are fitted (iterative particle reconstruction: Wieneke 2013, Meas. Sci. Technol.
24 024008).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial import cKDTree

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.volume import Limits

MOST = 8.0  # standard deviations that one pixel counts at most
LEAST = 4.0  # standard deviations of a spot, in each camera
ROUNDED = 0.9  # px, as much more along a line of sight, whose steps and spots are rounded
APART = 0.7  # px, of a spot from the image of its place, root mean square
HIDDEN_FROM = 4  # cameras from which on one need not show a particle: its image may lie in another one's
FEW = 0.01  # spots for each pixel of a camera above which lines of sight of all but one cross by chance everywhere
TOGETHER = 1 << 20  # points of lines of sight that are asked at a time

Array = NDArray[np.float64]


def crossings(
    cameras: Sequence[PinholeCamera],
    excess: Sequence[Array],
    image_px: Sequence[float],
    limits_mm: Limits,
    least: float = LEAST,
) -> tuple[Array, Array]:
    """Places (n, 3) in mm within ``limits_mm`` and their scores (n,), the sum of their spots' over the root of the
    number of cameras, best first. ``excess``: of each camera, (rows, columns), NaN where a pixel cannot be used;
    ``image_px``: standard deviation of a particle's image in each."""
    spots = [bright_spots(one, spread, least) for one, spread in zip(excess, image_px, strict=True)]
    found = [of_spots(cameras, spots, limits_mm)]
    if len(cameras) >= HIDDEN_FROM:
        used = [np.unique(found[0][2][:, k]) for k in range(len(cameras))]
        left = [(np.delete(at, own, 0), np.delete(score, own)) for (at, score), own in zip(spots, used, strict=True)]
        if max(len(at) / one.size for (at, _), one in zip(left, excess, strict=True)) < FEW:
            for hidden in range(len(cameras)):
                seeing = [k for k in range(len(cameras)) if k != hidden]
                found.append(of_spots([cameras[k] for k in seeing], [left[k] for k in seeing], limits_mm))
    place, score = (np.concatenate([one[k] for one in found]) for k in (0, 1))
    order = np.argsort(-score, kind="stable")
    return place[order], score[order]


def of_spots(
    cameras: Sequence[PinholeCamera], spots: Sequence[tuple[Array, Array]], limits_mm: Limits, apart: float = APART
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Places (n, 3) where all cameras have one of the ``spots``, ``apart`` pixels from their images at the most, root
    mean square; scores (n,), and which spots (n, cameras) they are."""
    count = len(cameras)
    nothing = np.empty((0, 3)), np.empty(0), np.empty((0, count), np.int64)
    if any(len(at) == 0 for at, _ in spots):
        return nothing
    trees, found = [cKDTree(at) for at, _ in spots], []
    for own, points in lines_of_sight(cameras, spots[0][0], limits_mm):
        matched, held = np.zeros((len(points), count), np.int64), np.ones(len(points), bool)
        matched[:, 0] = own
        for k in range(1, count):
            which = np.flatnonzero(held)
            off, matched[which, k] = trees[k].query(
                cameras[k].project(points[which]), distance_upper_bound=apart + ROUNDED
            )
            held[which] = np.isfinite(off)
        found.append((matched[held], points[held]))
    if not found:
        return nothing
    matched, points = (np.concatenate(each) for each in zip(*found, strict=True))
    matched, first = np.unique(matched, axis=0, return_index=True)  # steps of a line that meet the same spots
    if len(matched) == 0:
        return nothing
    seen = [at[matched[:, k]] for k, (at, _) in enumerate(spots)]
    place, off = triangulated(cameras, seen, points[first])
    low, high = np.array(limits_mm).T
    good = (off <= apart) & ((place >= low) & (place <= high)).all(1)
    place, matched = place[good], matched[good]
    score = np.sum([of_spot[matched[:, k]] for k, (_, of_spot) in enumerate(spots)], 0) / np.sqrt(count)
    taken, used = [], [np.zeros(len(at), bool) for at, _ in spots]
    for rank in np.argsort(-score, kind="stable"):
        if not any(each[number] for each, number in zip(used, matched[rank], strict=True)):
            taken.append(rank)
            for each, number in zip(used, matched[rank], strict=True):
                each[number] = True
    return place[taken], score[taken], matched[taken]


def bright_spots(excess: Array, image_px: float, least: float) -> tuple[Array, Array]:
    """Places (n, 2), column and row to a fraction of a pixel, and scores (n,) of the bright spots of a residual image
    (rows, columns), in standard deviations of its pixels."""
    clipped = np.clip(np.nan_to_num(excess), -MOST, MOST)
    score = gaussian_filter(clipped, image_px, mode="constant") * (2.0 * np.sqrt(np.pi) * image_px)
    top = (score == maximum_filter(score, 3, mode="constant")) & (score > least)
    top[[0, -1]] = top[:, [0, -1]] = False
    row, column = np.nonzero(top)
    off = []
    for below, above in (
        (score[row, column - 1], score[row, column + 1]),
        (score[row - 1, column], score[row + 1, column]),
    ):
        bend = 2.0 * score[row, column] - below - above
        off.append(np.clip(0.5 * (above - below) / np.where(bend > 0, bend, 1.0), -0.5, 0.5))
    return np.stack([column + off[0], row + off[1]], -1), score[row, column]


def lines_of_sight(
    cameras: Sequence[PinholeCamera], at: Array, limits_mm: Limits
) -> list[tuple[NDArray[np.int64], Array]]:
    """Points of the lines of sight of the first camera's pixels ``at`` (n, 2) within ``limits_mm``, a pixel of the
    other cameras apart: in parts, which line each is of (m,) and where (m, 3) mm."""
    along, start = cameras[0].rays(at), np.asarray(cameras[0].position_mm, float)
    low, high = np.array(limits_mm).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - start) / along, (high - start) / along])
    inside, outside = np.nanmax(ends.min(0), 1), np.nanmin(ends.max(0), 1)
    crosses = np.flatnonzero((outside > inside) & (outside > 0))
    inside, outside = np.maximum(inside[crosses], 0.0), outside[crosses]
    first, last = (start + along[crosses] * length[:, None] for length in (inside, outside))
    moves = [np.linalg.norm(camera.project(last) - camera.project(first), axis=1) for camera in cameras[1:]]
    steps = np.ceil(np.nan_to_num(np.max(moves, 0))).astype(np.int64) + 1
    parts, begin = [], 0
    while begin < len(crosses):
        end = max(int(np.searchsorted(np.cumsum(steps[begin:]), TOGETHER, "right")), 1) + begin
        count = steps[begin:end]
        line = np.repeat(np.arange(begin, end), count)
        share = (np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / np.repeat(count, count)
        parts.append((crosses[line], first[line] + share[:, None] * (last - first)[line]))
        begin = end
    return parts


def triangulated(
    cameras: Sequence[PinholeCamera], seen: Sequence[Array], place: Array, steps: int = 3
) -> tuple[Array, Array]:
    """Points (n, 3) in mm whose images are nearest to the pixels that are ``seen`` of them in each camera, (n, 2), and
    the root mean square of how far they are, px (n,); from about ``place`` (n, 3)."""
    place = place.copy()
    for _ in range(steps):
        moves = np.concatenate([camera.pixels_by_mm(place) for camera in cameras], 1)
        off = np.concatenate([at - camera.project(place) for at, camera in zip(seen, cameras, strict=True)], 1)
        normal = np.einsum("nki,nkj->nij", moves, moves)
        place += np.linalg.solve(normal, np.einsum("nki,nk->ni", moves, off)[:, :, None])[:, :, 0]
    off = np.stack([at - camera.project(place) for at, camera in zip(seen, cameras, strict=True)])
    return place, np.sqrt((off**2).sum(-1).mean(0))
