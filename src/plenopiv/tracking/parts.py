"""The field of scattered tracks on a grid, in parts that overlap: cost and memory grow linearly with a volume.

Each part is a ``field_from_tracks`` of its own, with a smoothing of its own. Where parts overlap their fields are
blended linearly, and so are their standard deviations, which are common to both for the most part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from plenopiv.errors import PlenoPIVError
from plenopiv.threads import each_in_threads, one_blas_thread
from plenopiv.tracking.field import LEAST_TRACKS, TrackField, field_from_tracks, known_tracks
from plenopiv.volume import Limits, within

SPACING = 1.5  # of nodes, in mean distances between tracks: three tracks to a cell
CELLS = 8  # between nodes, along each side of a part
BEYOND = 1.5  # cells by which a part reaches into its neighbours
NEAR = 1.5  # cells within which a point must have a track to count as measured

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FieldOnGrid:
    """``velocity`` and ``std`` (3, nz, ny, nx) in m/s, NaN in parts without tracks, or with too few in one corner;
    ``measured`` (nz, ny, nx): points with a track nearby; ``step_mm`` between nodes; of each part the ``smoothing`` and
    the ``scale`` of errors in its error bars; ``left_out``: share of the tracks that no part used."""

    velocity: Array
    std: Array
    measured: NDArray[np.bool_]
    step_mm: float
    smoothing: tuple[float, ...]
    scale: tuple[float, ...]
    left_out: float


def field_on_grid(
    position_mm: ArrayLike,
    velocity_m_s: ArrayLike,
    std_m_s: ArrayLike,
    limits_mm: Limits,
    axes_mm: tuple[Array, Array, Array],
    *,
    divergence_free: bool = True,
    step_mm: float | None = None,
    progress: Progress | None = None,
) -> FieldOnGrid:
    """The field of velocities (n, 3) in m/s, with standard deviations (n, 3), of tracks at (n, 3) mm within
    ``limits_mm``, at the points of a grid, ``axes_mm`` along x, y and z. ``step_mm``: between nodes, by default as
    far as the density of the tracks allows. Tracks with a number that is not finite are left out.

    Raises:
        PlenoPIVError: fewer than 64 tracks within the limits, all of them in a plane, or a standard deviation that is
            not positive.
    """
    position, velocity, std = (np.asarray(each, np.float64) for each in (position_mm, velocity_m_s, std_m_s))
    low, high = np.array(limits_mm).T
    inside = within(position, limits_mm) & known_tracks(position, velocity, std)
    position, velocity, std = position[inside], velocity[inside], std[inside]
    if len(position) < LEAST_TRACKS:
        raise PlenoPIVError(
            f"tracking: {len(position)} tracks in the volume make no field, which takes {LEAST_TRACKS}; are frames and "
            "max_displacement_mm right?"
        )
    step = step_mm or SPACING * float(np.prod(high - low) / len(position)) ** (1 / 3)
    cores = [_cores(lo, hi, step) for lo, hi in limits_mm]
    shape = tuple(len(axis) for axis in reversed(axes_mm))
    total, spread, weight = np.zeros((3, *shape)), np.zeros((3, *shape)), np.zeros(shape)
    used, of_parts = np.zeros(len(position), bool), list[tuple[float, float]]()
    parts, beyond = list(product(cores[0], cores[1], cores[2])), BEYOND * step
    boxes = [_widened(part, limits_mm, beyond) for part in parts]

    def made(number: int) -> tuple[NDArray[np.bool_], TrackField, tuple | None] | None:
        box = boxes[number]
        own = within(position, box)
        if own.sum() < LEAST_TRACKS:
            return None
        tracks = position[own], velocity[own], std[own]
        try:
            field = field_from_tracks(
                *tracks, box, step, divergence_free=divergence_free, seed=number + 1, core_mm=parts[number]
            )
        except PlenoPIVError:  # all of them in one corner, or in a plane
            return None
        own[own] = field.used
        return own, field, _on_grid(field, parts[number], limits_mm, axes_mm, beyond)

    with one_blas_thread():
        for done, found in enumerate(each_in_threads(made, range(len(parts))), 1):
            if found is not None:
                own, field, on_grid = found
                used |= own
                of_parts.append((field.smoothing, field.scale))
                if on_grid is not None:
                    where, share, values, errors = on_grid
                    total[(slice(None), *where)] += values * share
                    spread[(slice(None), *where)] += errors * share
                    weight[where] += share
            if progress is not None:
                progress(done, len(parts))
    if not of_parts:
        raise PlenoPIVError(
            f"tracking: no part of the volume has {LEAST_TRACKS} tracks that are not all in a plane or a corner; there "
            "is no field"
        )
    with np.errstate(invalid="ignore"):
        total, spread = total / weight, spread / weight
    z, y, x = np.meshgrid(*reversed(axes_mm), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
    near = cKDTree(position[used]).query(points, distance_upper_bound=NEAR * step)[0] < np.inf
    measured = near.reshape(shape) & (weight > 0)
    smoothing, scale = zip(*of_parts, strict=True)
    return FieldOnGrid(total, spread, measured, step, smoothing, scale, float(1.0 - used.mean()))


def _widened(part: tuple, limits: Limits, beyond: float) -> Limits:
    """A part with what it shares with its neighbours."""
    x, y, z = ((max(lo - beyond, a), min(hi + beyond, b)) for (lo, hi), (a, b) in zip(part, limits, strict=True))
    return x, y, z


def _cores(low: float, high: float, step: float) -> list[tuple[float, float]]:
    """The intervals along an axis that parts cover without their overlap."""
    count = max(round((high - low) / (CELLS * step)), 1)
    ends = np.linspace(low, high, count + 1)
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def _on_grid(
    field: TrackField, part: tuple, limits: Limits, axes: tuple[Array, ...], beyond: float
) -> tuple[tuple, Array, Array, Array] | None:
    """Where a part has a share in the points (nz, ny, nx) of the grid, its share of each, and its velocities and their
    standard deviations (3, nz, ny, nx) there; None where it has none."""
    shares, places = [], []
    for (lo, hi), (low, high), axis in zip(part, limits, axes, strict=True):
        rise = np.ones(len(axis)) if lo <= low else np.clip((axis - lo) / (2 * beyond) + 0.5, 0.0, 1.0)
        fall = np.ones(len(axis)) if hi >= high else np.clip((hi - axis) / (2 * beyond) + 0.5, 0.0, 1.0)
        share = rise * fall
        places.append(np.flatnonzero(share > 0))
        shares.append(share[places[-1]])
    if not all(len(place) for place in places):
        return None
    (i, j, k), (x, y, z) = places, [axis[place] for axis, place in zip(axes, places, strict=True)]
    points = np.stack([each.ravel() for each in reversed(np.meshgrid(z, y, x, indexing="ij"))], -1)
    share = np.einsum("k,j,i->kji", *reversed(shares))
    values, errors = (each.T.reshape(3, *share.shape) for each in field.velocity(points))
    whole = tuple(slice(each[0], each[-1] + 1) for each in (k, j, i))  # places are without gaps
    return whole, share, values, errors
