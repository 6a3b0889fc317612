"""Where a residual image still holds the light of particles: every place is asked what its pixels have in common.

A place of the volume sends rays, one for about a pixel of its light, to the pixels that it would light. Each pixel says
by how many standard deviations it is brighter than the particles known so far make it, at most MOST, so that a few
bright pixels of another particle do not count as many. The sum over the square root of their number is a place's score:
normal noise has 1. Local maxima above LEAST are returned, the highest within reach of each other alone; the rest is
looked for again once these are fitted. Whether they are particles is decided after that (``evidence``). A quarter of
the rays, spread over the aperture, is asked first: a place where their mean is below POOR of what LEAST needs scores
nothing.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.kernels import inlined, kernel
from plenopiv.lattice import nearest_lens
from plenopiv.threads import in_threads
from plenopiv.tracking.light_kernels import LightConstants
from plenopiv.volume import Limits

MOST = 4.0  # standard deviations that one pixel counts at most
LEAST = 9.0  # score of a place that is worth a fit; noise alone does not reach 6
FIRST, POOR = (
    4,
    0.3,
)  # which part of the rays is asked first, and what share of the mean that LEAST needs they must show
SEEN = 0.15  # share of the rays that must fall on pixels that are used
STEP_PITCHES = 0.4  # of places in the plane, in microlens pitches of the focal plane
STEP_DEPTH = 2.0  # of places in depth, by how much the blur's diameter grows, in such steps
APART_PITCHES = 1.6  # within which the highest maximum alone is taken

Array = NDArray[np.float64]
nearest = inlined(nearest_lens)


@kernel
def _scores(
    begin: int, end: int,
    cam: LightConstants,
    excess: NDArray[np.float32],  # (rows * columns,): standard deviations, clipped; NaN where a pixel cannot be used
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], z_mm: NDArray[np.float64],
    ray: NDArray[np.float64],  # (rays, 2): on the main lens, mm, the first of them spread as all are
    poor: float,  # mean of the first rays below which the others are not asked
    score: NDArray[np.float32],  # (nz, ny, nx), filled
) -> None:  # fmt: skip
    """Scores of the rows ``begin`` to ``end`` of places, k * ny + j, on a regular lattice of microlenses."""
    ny, rays, e = y_mm.size, ray.shape[0], cam.image_scale
    first, to_px = rays // FIRST, cam.pitch / cam.pixel
    on_array, on_sensor = np.empty((rays, 2)), np.empty((rays, 2))
    before = -1
    for row in range(begin, end):
        k, j = row // ny, row % ny
        distance = cam.object_distance - z_mm[k]
        a = 1.0 + cam.image_distance / distance - cam.image_distance / cam.focal
        b = -cam.image_distance / distance
        if k != before:  # where rays are beside that through the middle: pitches along and across rows, pixels
            before = k
            for r in range(rays):
                u, v = ray[r, 0], ray[r, 1]
                on_array[r, 0] = a * (cam.cos * u + cam.sin * v) / cam.pitch
                on_array[r, 1] = a * (cam.cos * v - cam.sin * u) / cam.pitch
                on_sensor[r, 0], on_sensor[r, 1] = e * (1.0 - a) * u / cam.pixel, -e * (1.0 - a) * v / cam.pixel
        for i in range(x_mm.size):
            total, used = 0.0, 0
            image_s, image_t = b * x_mm[i], b * y_mm[j]
            ds, dt = image_s - cam.offset_s, image_t - cam.offset_t
            along, across = (cam.cos * ds + cam.sin * dt) / cam.pitch, (cam.cos * dt - cam.sin * ds) / cam.pitch
            column0 = cam.column0 - (cam.offset_s + e * image_s) / cam.pixel + 0.5
            row0 = cam.row0 + (cam.offset_t + e * image_t) / cam.pixel + 0.5
            for r in range(rays):
                if r == first and total < poor * used:
                    used = 0
                    break
                lens_a, lens_b = nearest(
                    cam.hexagonal, cam.row_spacing, along + on_array[r, 0], across + on_array[r, 1]
                )
                if cam.hexagonal:
                    lens_a, lens_b = lens_a + 0.5 * (np.int64(lens_b) & 1), lens_b * cam.row_spacing
                lens_s, lens_t = cam.cos * lens_a - cam.sin * lens_b, cam.sin * lens_a + cam.cos * lens_b
                column = int(np.floor(column0 - lens_s * to_px + on_sensor[r, 0]))
                line = int(np.floor(row0 + lens_t * to_px + on_sensor[r, 1]))
                if 0 <= column < cam.columns and 0 <= line < cam.rows:
                    value = excess[line * cam.columns + column]
                    if not np.isnan(value):
                        total += value
                        used += 1
            score[k, j, i] = total / sqrt(float(used)) if used > SEEN * rays else 0.0


def places_of_light(
    camera: PlenopticCamera, constants: LightConstants, excess: Array, limits_mm: Limits, poor: float = POOR
) -> tuple[Array, Array]:
    """Places (n, 3) in mm within ``limits_mm`` that may hold a particle more, and their scores (n,), best first.

    ``excess`` (rows * columns,): standard deviations by which each pixel is brighter than the known particles make it;
    NaN where it cannot be used. ``poor``: share of the mean that is needed which the first rays must show.
    """
    pitch = camera.lattice.pitch_mm / abs(camera.main_lens.magnification)
    step = STEP_PITCHES * pitch
    radius = 0.5 * camera.main_lens.aperture_mm
    deep = STEP_DEPTH * step / (2.0 * radius) * camera.main_lens.object_distance_mm
    x, y, z = (_axis(lo, hi, d) for (lo, hi), d in zip(limits_mm, (step, step, deep), strict=True))
    n = round(pi * camera.aperture_radius_px**2)
    turn, r = 2.0 * pi * (sqrt(5.0) - 1.0) / 2.0 * np.arange(n), radius * 0.97 * np.sqrt((np.arange(n) + 0.5) / n)
    ray = np.stack([r * np.cos(turn), r * np.sin(turn)], -1)[np.argsort(np.arange(n) % FIRST, kind="stable")]
    score = np.empty((z.size, y.size, x.size), np.float32)
    clipped = np.clip(excess, -MOST, MOST).astype(np.float32)
    in_threads(_scores, z.size * y.size, constants, clipped, x, y, z, ray, poor * LEAST / sqrt(n), score)
    top = (score == maximum_filter(score, 3, mode="constant")) & (score > LEAST)
    k, j, i = np.nonzero(top)
    order = np.argsort(-score[k, j, i], kind="stable")
    place = np.stack([x[i], y[j], z[k]], -1)[order]
    value = score[k, j, i][order].astype(np.float64)
    taken = np.ones(len(place), bool)
    if len(place):
        near = cKDTree(place[:, :2]).query_ball_point(place[:, :2], APART_PITCHES * pitch)
        for rank, others in enumerate(near):
            taken[rank] = not any(taken[other] for other in others if other < rank)
    return place[taken], value[taken]


def _axis(lo: float, hi: float, step: float) -> Array:
    count = max(int(np.ceil((hi - lo) / step)), 1)
    return np.asarray(lo + (np.arange(count) + 0.5) * ((hi - lo) / count), np.float64)
