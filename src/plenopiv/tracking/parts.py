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
from plenopiv.tracking.field import LEAST_TRACKS, TrackField, field_from_tracks
from plenopiv.volume import Limits, within

SPACING = 1.5  # of nodes, in mean distances between tracks: three tracks to a cell
CELLS = 8  # between nodes, along each side of a part
BEYOND = 1.5  # cells by which a part reaches into its neighbours
NEAR = 1.5  # cells within which a point must have a track to count as measured

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FieldOnGrid:
    """``velocity`` and ``std`` (3, nz, ny, nx) in m/s, NaN in parts without tracks; ``measured`` (nz, ny, nx): points
    with a track nearby; ``step_mm`` between nodes; of each part the ``smoothing`` and the ``scale`` of its tracks'
    standard deviations; ``left_out``: share of the tracks that no part used."""

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
    far as the density of the tracks allows.

    Raises:
        PlenoPIVError: fewer than 64 tracks within the limits.
    """
    position, velocity, std = (np.asarray(each, np.float64) for each in (position_mm, velocity_m_s, std_m_s))
    low, high = np.array(limits_mm).T
    inside = within(position, limits_mm)
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
    used, fields = np.zeros(len(position), bool), list[TrackField]()
    parts = list(product(*cores))
    for done, part in enumerate(parts, 1):
        limits = [
            (max(lo - BEYOND * step, a), min(hi + BEYOND * step, b))
            for (lo, hi), (a, b) in zip(part, limits_mm, strict=True)
        ]
        own = ((position >= [lo for lo, _ in limits]) & (position <= [hi for _, hi in limits])).all(1)
        if own.sum() >= LEAST_TRACKS:
            box = limits[0], limits[1], limits[2]
            tracks = position[own], velocity[own], std[own]
            field = field_from_tracks(*tracks, box, step, divergence_free=divergence_free, seed=done)
            used[np.flatnonzero(own)[field.used]] = True
            fields.append(field)
            _add(field, part, limits_mm, axes_mm, BEYOND * step, total, spread, weight)
        if progress is not None:
            progress(done, len(parts))
    if not fields:
        raise PlenoPIVError(f"tracking: no part of the volume has {LEAST_TRACKS} tracks; there is no field")
    with np.errstate(invalid="ignore"):
        total, spread = total / weight, spread / weight
    z, y, x = np.meshgrid(*reversed(axes_mm), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
    near = cKDTree(position[used]).query(points, distance_upper_bound=NEAR * step)[0] < np.inf
    measured = near.reshape(shape) & (weight > 0)
    of_parts = tuple(each.smoothing for each in fields), tuple(each.scale for each in fields)
    return FieldOnGrid(total, spread, measured, step, *of_parts, float(1.0 - used.mean()))


def _cores(low: float, high: float, step: float) -> list[tuple[float, float]]:
    """The intervals along an axis that parts cover without their overlap."""
    count = max(round((high - low) / (CELLS * step)), 1)
    ends = np.linspace(low, high, count + 1)
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def _add(
    field: TrackField, part: tuple, limits: Limits, axes: tuple[Array, ...], beyond: float,
    total: Array, spread: Array, weight: Array,
) -> None:  # fmt: skip
    """Add the field of a part, weighed with its share of the points, in place."""
    shares, places = [], []
    for (lo, hi), (low, high), axis in zip(part, limits, axes, strict=True):
        rise = np.ones(len(axis)) if lo <= low else np.clip((axis - lo) / (2 * beyond) + 0.5, 0.0, 1.0)
        fall = np.ones(len(axis)) if hi >= high else np.clip((hi - axis) / (2 * beyond) + 0.5, 0.0, 1.0)
        share = rise * fall
        places.append(np.flatnonzero(share > 0))
        shares.append(share[places[-1]])
    if not all(len(place) for place in places):
        return
    (i, j, k), (x, y, z) = places, [axis[place] for axis, place in zip(axes, places, strict=True)]
    points = np.stack([each.ravel() for each in reversed(np.meshgrid(z, y, x, indexing="ij"))], -1)
    share = np.einsum("k,j,i->kji", *reversed(shares))
    where = np.ix_(k, j, i)
    for values, into in zip(field.velocity(points), (total, spread), strict=True):
        for each, own in zip(into, values.T, strict=True):
            each[where] += own.reshape(share.shape) * share
    weight[where] += share
