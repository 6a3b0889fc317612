"""Where a residual image still holds the light of particles: every place is asked what its pixels have in common.

A place of the volume sends rays, one for about a pixel of its light, to the pixels that it would light. Each pixel says
by how many standard deviations it is brighter than the particles known so far make it, at most MOST, so that a few
bright pixels of another particle do not count as many. The sum over the square root of their number is a place's score:
normal noise has 1. Local maxima above LEAST are returned, the highest within reach of each other alone; the rest is
looked for again once these are fitted. Whether they are particles is decided after that (``evidence``).

Places lie where their chief rays meet the microlenses at the same parts of a pitch, in every plane of depth. A ray
then falls as many microlenses from its place's own for all places of one kind, so that a plane's scores are sums of
shifted views: images with one pixel of each microlens.
"""

from __future__ import annotations

from math import ceil, floor, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.kernels import inlined, kernel, part
from plenopiv.lattice import nearest_lens
from plenopiv.threads import in_threads
from plenopiv.tracking.light_kernels import LightConstants
from plenopiv.volume import Limits

MOST = 4.0  # standard deviations that one pixel counts at most
LEAST = 9.0  # score of a place that is worth a fit; noise alone does not reach 7
SEEN = 0.15  # share of the rays that must fall on pixels that are used
ALONG, ACROSS = 4, 4  # places to a pitch along rows of microlenses, and to a row across them; every other row of a
# hexagonal lattice is half a pitch beside: an even number along makes places of one grid
LARGEST = 127  # that a byte holds
TOGETHER = 8  # planes scored at a time
STEP_DEPTH = 0.4  # of places in depth, by how much the blur's diameter grows, in pitches of the focal plane
APART_PITCHES = 1.6  # within which the highest maximum alone is taken

Array = NDArray[np.float64]
Int = NDArray[np.int64]
nearest = inlined(nearest_lens)


def places_of_light(
    camera: PlenopticCamera, constants: LightConstants, centres: Array, excess: Array, limits_mm: Limits
) -> tuple[Array, Array]:
    """Places (n, 3) in mm within ``limits_mm`` that may hold a particle more, and their scores (n,), best first.

    ``centres`` (nj, ni, 2): of the microlenses, mm; ``excess`` (rows * columns,): standard deviations by which each
    pixel is brighter than the known particles make it; NaN where it cannot be used.
    """
    pitch = camera.lattice.pitch_mm / abs(camera.main_lens.magnification)
    radius = 0.5 * camera.main_lens.aperture_mm
    deep = STEP_DEPTH * pitch / (2.0 * radius) * camera.main_lens.object_distance_mm
    lo, hi = limits_mm[2]
    count = max(ceil((hi - lo) / deep), 1)
    z = lo + (np.arange(count) + 0.5) * ((hi - lo) / count)
    n = round(pi * camera.aperture_radius_px**2)
    turn, r = 2.0 * pi * (sqrt(5.0) - 1.0) / 2.0 * np.arange(n), radius * 0.97 * np.sqrt((np.arange(n) + 0.5) / n)
    ray = np.stack([r * np.cos(turn), r * np.sin(turn)], -1)
    views, used = np.empty((n, *centres.shape[:2]), np.int8), np.empty((n, *centres.shape[:2]), np.uint8)
    unit = MOST / min(LARGEST, 32767 // n)  # of which n make no more than 16 bits hold
    in_threads(_views, n, constants, centres, np.clip(excess, -MOST, MOST).astype(np.float32), unit, ray, views, used)
    rows, columns = _lenses(camera, constants, limits_mm)
    fixed = constants, views, used, unit, ray, np.array([*rows, *columns]), np.array(limits_mm, np.float64)
    shape = (rows[1] - rows[0]) * ACROSS, (columns[1] - columns[0]) * ALONG + ALONG // 2
    score, found = np.zeros((TOGETHER + 2, *shape), np.float32), []
    top = np.empty((TOGETHER, *shape), np.bool_)
    for first in range(0, z.size + 1, TOGETHER):  # planes before the first and after the last one score nothing
        some = z[first : first + TOGETHER]
        score[:2], score[2:] = score[-2:], 0.0
        in_threads(_scores, some.size, *fixed, some, score[2:])
        in_threads(_maxima, TOGETHER * shape[0], score, top)
        at = np.nonzero(top)
        found.append((at[0] + first - 1, *at[1:], score[1:-1][at]))
    k, j, i, value = (np.concatenate(each) for each in zip(*found, strict=True))
    value = value.astype(np.float64)
    order = np.argsort(-value, kind="stable")
    k, j, i, value = k[order], j[order], i[order], value[order]
    s, t = _on_array(constants, columns[0] + i / ALONG, constants.row_spacing * (rows[0] + j / ACROSS))
    scale = camera.scale(z[k])
    place = np.clip(np.stack([s / scale, t / scale, z[k]], -1), *np.transpose(limits_mm))
    taken = np.zeros(len(place), bool)
    if len(place):
        _highest(place[:, :2] / (APART_PITCHES * pitch), taken)
    return place[taken], value[taken]


def _lenses(camera: PlenopticCamera, cam: LightConstants, limits_mm: Limits) -> tuple[tuple[int, int], tuple[int, int]]:
    """The rows and columns of microlenses, first and one past, that hold the chief rays of all places within limits."""
    corner = np.array(np.meshgrid(*limits_mm)).reshape(3, -1)
    s, t = camera.scale(corner[2]) * corner[:2]
    ds, dt = (s - cam.offset_s) / cam.pitch, (t - cam.offset_t) / cam.pitch
    along, across = cam.cos * ds + cam.sin * dt, (cam.cos * dt - cam.sin * ds) / cam.row_spacing
    rows = floor(across.min()), floor(across.max()) + 1
    return rows, (floor(along.min() - 0.5), floor(along.max()) + 1)


@part
def _on_array(cam: LightConstants, along: Any, across: Any) -> tuple[Any, Any]:
    """(s, t) in mm of places on the regular lattice, in pitches."""
    return (
        cam.offset_s + cam.pitch * (cam.cos * along - cam.sin * across),
        cam.offset_t + cam.pitch * (cam.sin * along + cam.cos * across),
    )


@kernel
def _maxima(begin: int, end: int, score: NDArray[np.float32], top: NDArray[np.bool_]) -> None:
    """Which ``top`` (planes, rows, columns) of the scores (planes + 2, rows, columns) are above LEAST and none about
    them exceeds, in rows ``begin`` to ``end`` of all planes but the first and the last."""
    rows, columns = score.shape[1:]
    for row in range(begin, end):
        k, j = row // rows + 1, row % rows
        for i in range(columns):
            value = score[k, j, i]
            best = value > LEAST
            if best:
                for z in range(k - 1, k + 2):
                    for y in range(max(j - 1, 0), min(j + 2, rows)):
                        for x in range(max(i - 1, 0), min(i + 2, columns)):
                            best = best and score[z, y, x] <= value
            top[k - 1, j, i] = best


@kernel
def _highest(place: NDArray[np.float64], taken: NDArray[np.bool_]) -> None:
    """Which places (n, 2), best first, have no better one that is ``taken`` within 1 of them; zeros on entry."""
    x0, y0 = place[:, 0].min() - 1.0, place[:, 1].min() - 1.0
    rows, columns = int(place[:, 1].max() - y0) + 2, int(place[:, 0].max() - x0) + 2
    last, before = np.full((rows, columns), -1), np.full(len(place), -1)  # taken in a square of side 1; before each
    for n in range(len(place)):
        column, row = int(place[n, 0] - x0), int(place[n, 1] - y0)
        free = True
        for j in range(row - 1, row + 2):
            for i in range(column - 1, column + 2):
                other = last[j, i]
                while other >= 0:
                    dx, dy = place[n, 0] - place[other, 0], place[n, 1] - place[other, 1]
                    free = free and dx * dx + dy * dy > 1.0
                    other = before[other]
        if free:
            taken[n], before[n], last[row, column] = True, last[row, column], n


@kernel
def _views(
    begin: int, end: int,
    cam: LightConstants,
    centres: NDArray[np.float64],  # (nj, ni, 2), mm
    excess: NDArray[np.float32],  # (rows * columns,): standard deviations, clipped; NaN where a pixel cannot be used
    unit: float,  # standard deviations that one in ``views`` stands for
    ray: NDArray[np.float64],  # (rays, 2): on the main lens, mm
    views: NDArray[np.int8], used: NDArray[np.uint8],  # (rays, nj, ni), filled
) -> None:  # fmt: skip
    """Under each microlens the pixel that the rays ``begin`` to ``end`` fall on, 0 where there is none to be used."""
    e = cam.image_scale
    for r in range(begin, end):
        for j in range(centres.shape[0]):
            for i in range(centres.shape[1]):
                s, t = (1.0 + e) * centres[j, i, 0] - e * ray[r, 0], (1.0 + e) * centres[j, i, 1] - e * ray[r, 1]
                column, line = floor(cam.column0 - s / cam.pixel + 0.5), floor(cam.row0 + t / cam.pixel + 0.5)
                views[r, j, i], used[r, j, i] = 0, 0
                if 0 <= column < cam.columns and 0 <= line < cam.rows:
                    value = excess[line * cam.columns + column]
                    if not np.isnan(value):
                        views[r, j, i], used[r, j, i] = round(value / unit), 1


@kernel
def _scores(
    begin: int, end: int,
    cam: LightConstants,
    views: NDArray[np.int8], used: NDArray[np.uint8],  # (rays, nj, ni)
    unit: float, ray: NDArray[np.float64],  # as of ``_views``
    lenses: Int,  # first row of lenses, one past the last, first column, one past the last
    limits: NDArray[np.float64], z_mm: NDArray[np.float64],  # (3, 2) mm; (planes,)
    score: NDArray[np.float32],  # (planes, rows of places, columns of places), zeros on entry, filled
) -> None:  # fmt: skip
    """Scores of the planes ``begin`` to ``end``, of places within the limits or half a step beyond."""
    rays, nj, ni = views.shape
    j0, j1, i0, i1 = lenses
    width = i1 - i0
    total, seen = np.empty(width, np.int16), np.empty(width, np.int16)
    off_i, off_j = np.empty(rays, np.int64), np.empty(rays, np.int64)
    for k in range(begin, end):
        distance = cam.object_distance - z_mm[k]
        a = 1.0 + cam.image_distance / distance - cam.image_distance / cam.focal
        b = -cam.image_distance / distance
        half = 0.5 * cam.pitch / min(ALONG, ACROSS) / abs(b)
        for kind in range(ALONG * ACROSS):
            p, q = kind % ALONG, kind // ALONG
            for r in range(rays):  # microlenses from a place's own to the one that the ray meets, of even rows
                u, v = ray[r, 0], ray[r, 1]
                along = p / ALONG + a * (cam.cos * u + cam.sin * v) / cam.pitch
                across = q / ACROSS * cam.row_spacing + a * (cam.cos * v - cam.sin * u) / cam.pitch
                lens_i, lens_j = nearest(cam.hexagonal, cam.row_spacing, along, across)
                off_i[r], off_j[r] = int(lens_i), int(lens_j)
            for j in range(j0, j1):
                odd = (j & 1) if cam.hexagonal else 0
                total[:] = 0
                seen[:] = 0
                for r in range(rays):
                    row, off = j + off_j[r] - cam.j0, off_i[r] + (odd & off_j[r])
                    if not 0 <= row < nj:
                        continue
                    first = max(i0, cam.i0 - off)  # of the places whose ray meets a microlens
                    last = min(i1, cam.i0 + ni - off)
                    if last <= first:
                        continue
                    to, at = np.uint32(first - i0), np.uint32(first + off - cam.i0)
                    for n in range(np.uint32(last - first)):  # without a sign, or it is not vectorised
                        total[to + n] += views[r, row, at + n]
                    for n in range(np.uint32(last - first)):
                        seen[to + n] += used[r, row, at + n]
                line = (j - j0) * ACROSS + q
                across = (j + q / ACROSS) * cam.row_spacing
                for n in range(width):
                    if seen[n] <= SEEN * rays:
                        continue
                    along = i0 + n + p / ALONG + 0.5 * odd
                    s, t = _on_array(cam, along, across)
                    x, y = s / b, t / b
                    beside_x = max(limits[0, 0] - x, x - limits[0, 1])
                    if max(beside_x, limits[1, 0] - y, y - limits[1, 1]) <= half:
                        score[k, line, n * ALONG + p + odd * (ALONG // 2)] = unit * total[n] / sqrt(float(seen[n]))
