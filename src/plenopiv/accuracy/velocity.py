"""Errors of a velocity field against particles that are known in both frames, in voxels per frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.accuracy.truth import true_displacements
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.errors import PlenoPIVError

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
GROSS_VOXELS = 2.0  # an error of more than this on any axis is a gross one
POINT_SHARE = 0.9  # of the vectors must have a point truth for errors against it to be given
DIMS = ("z", "y", "x")


@dataclass(frozen=True)
class Band:
    """Vectors between two distances from the focal plane: |z| limits in mm, RMS and bias along x, y, z in voxels."""

    from_mm: float
    to_mm: float
    vectors: int
    rms: tuple[float, ...]
    bias: tuple[float, ...]


@dataclass(frozen=True)
class Errors:
    """Errors of one set of vectors.

    ``answered``: share of the vectors that are finite. ``gross``: share of those with an error above ``GROSS_VOXELS``
    on any axis; they are left out of ``rms`` and ``bias`` (voxels along x, y, z; NaN where nothing is left).
    ``by_depth``: three bands of |z| with a third of the vectors each.
    """

    answered: float
    gross: float
    rms: tuple[float, ...]
    bias: tuple[float, ...]
    by_depth: tuple[Band, ...]


@dataclass(frozen=True)
class Score:
    """A velocity field against the truth.

    ``vectors`` were judged; ``vectors_at_half_overlap`` is how many a field with half-overlapping windows would have
    there. ``final`` and ``raw`` (before windows were replaced, None without u_raw) against window truth,
    ``final_at_point`` and ``raw_at_point`` against point truth (None where too few vectors have one). ``replaced``:
    share of the vectors that the field itself calls replaced. ``inside_1_std``, ``inside_2_std``: share of the errors
    along x, y, z within one and two stated standard deviations (None without u_std); 0.68 and 0.95 where the standard
    deviations are right.
    ``true_rms``: voxels.
    """

    vectors: int
    vectors_at_half_overlap: int
    particles_per_window: float
    final: Errors
    raw: Errors | None
    final_at_point: Errors | None
    raw_at_point: Errors | None
    replaced: float | None
    inside_1_std: tuple[float, ...] | None
    inside_2_std: tuple[float, ...] | None
    true_rms: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain dictionaries and numbers, for JSON."""
        return asdict(self)


def score_velocity(
    dataset: xarray.Dataset,
    a_mm: ArrayLike,
    b_mm: ArrayLike,
    camera: PlenopticCamera,
    *,
    dt_s: float,
    voxel_mm: tuple[float, float, float],
    window_voxels: tuple[int, int, int] = (64, 64, 16),
    time: int = 0,
    space: SpaceMap | None = None,
) -> Score:
    """Score a velocity field against particles at ``a_mm`` and ``b_mm`` (n, 3) in the two frames.

    ``dataset``: dims (time, z, y, x) or (z, y, x), coordinates in mm, u, v, w in m/s; where present u_raw, v_raw,
    w_raw, u_std, v_std, w_std and valid (1 measured, 0 replaced). ``time``: which of its fields. ``window_voxels``:
    the last interrogation window along x, y, z. ``space``: particles and vectors are in the laboratory; bands of depth
    are the lens' then too.

    Vectors are judged where whole windows lie inside the seeded volume (the box of the particles at mid-time) and every
    view sees all of them.

    Raises:
        PlenoPIVError: no vector can be judged, or the dataset has other dims.
    """
    a, b = np.asarray(a_mm, np.float64), np.asarray(b_mm, np.float64)
    field = dataset.isel(time=time) if "time" in dataset.dims else dataset
    for name in "uvw":
        if field[name].dims != DIMS:
            raise PlenoPIVError(f"accuracy: {name} has dims {field[name].dims}, wanted (time, z, y, x)")
    voxel = np.asarray(voxel_mm, np.float64)
    half = 0.5 * voxel * window_voxels
    middle = 0.5 * (a + b)
    lo, hi = middle.min(0) + half, middle.max(0) - half

    at = _points(field.x.values, field.y.values, field.z.values)
    chosen = np.flatnonzero(((at >= lo) & (at <= hi)).all(1) & _windows_seen(camera, at, half, space))
    truth = true_displacements(at[chosen], a, b, half)
    known = np.isfinite(truth.window).all(1)
    if not known.any():
        raise PlenoPIVError("accuracy: no vector has a whole window inside the seeded volume and in every view")
    chosen = chosen[known]
    window, point = truth.window[known] / voxel, truth.point[known] / voxel
    to_voxels = 1e3 * dt_s / voxel  # m/s -> mm per frame -> voxels

    def values(suffix: str) -> Array:
        columns = [field[name + suffix].values.astype(np.float64).reshape(-1)[chosen] for name in "uvw"]
        return np.stack(columns, -1) * to_voxels

    depth = np.abs((at[chosen] if space is None else space.to_lens(at[chosen]))[:, 2])
    final = values("")
    raw = values("_raw") if "u_raw" in field else None
    has_point = np.isfinite(point).all(1).mean() > POINT_SHARE
    std = values("_std") if "u_std" in field else None
    off = np.where(np.isfinite(final).all(axis=1, keepdims=True), np.abs(final - window), np.inf)
    grid = _points(*(np.arange(first, last + 1e-9, step) for first, last, step in zip(lo, hi, half, strict=True)))
    return Score(
        vectors=len(chosen),
        vectors_at_half_overlap=int(_windows_seen(camera, grid, half, space).sum()),
        particles_per_window=float(truth.particles[known].mean()),
        final=_errors(final, window, depth),
        raw=None if raw is None else _errors(raw, window, depth),
        final_at_point=_errors(final, point, depth) if has_point else None,
        raw_at_point=_errors(raw, point, depth) if has_point and raw is not None else None,
        replaced=float((field["valid"].values.reshape(-1)[chosen] == 0).mean()) if "valid" in field else None,
        inside_1_std=None if std is None else _tuple((off <= std).mean(0)),
        inside_2_std=None if std is None else _tuple((off <= 2 * std).mean(0)),
        true_rms=_tuple(_rms(window)),
    )


def pooled(scores: Sequence[Score]) -> Errors:
    """Final errors of several fields of one kind as those of one; bands of depth must be the same for all.

    A field of which every vector is gross counts as that alone.
    """
    vectors = np.array([score.vectors for score in scores], float)
    answered = np.array([score.final.answered for score in scores])
    gross = np.array([score.final.gross for score in scores])
    finals = [score.final for score in scores if score.final.by_depth]
    left = [n for n, score in zip(vectors * answered * (1 - gross), scores, strict=True) if score.final.by_depth]
    bands = []
    for band in zip(*(final.by_depth for final in finals), strict=True):
        of = [b.vectors for b in band]
        rms, bias = _pooled_rms([b.rms for b in band], of), _mean([b.bias for b in band], of)
        bands.append(Band(band[0].from_mm, band[0].to_mm, sum(of), rms, bias))
    return Errors(
        float(np.average(answered, weights=vectors)),
        float(np.average(gross, weights=vectors * answered)) if answered.any() else 0.0,
        _pooled_rms([f.rms for f in finals], left) if finals else (nan,) * 3,
        _mean([f.bias for f in finals], left) if finals else (nan,) * 3,
        tuple(bands),
    )


def _mean(values: Sequence[Sequence[float]], of: Sequence[float]) -> tuple[float, ...]:
    return _tuple(np.average(values, axis=0, weights=of))


def _pooled_rms(values: Sequence[Sequence[float]], of: Sequence[float]) -> tuple[float, ...]:
    return _tuple(np.sqrt(np.average(np.square(values), axis=0, weights=of)))


def _points(x: Array, y: Array, z: Array) -> Array:
    """All points of a grid, (n, 3) as x, y, z, x running fastest."""
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    return np.stack([xx, yy, zz], -1).reshape(-1, 3).astype(np.float64)


def _windows_seen(
    camera: PlenopticCamera, at_mm: Array, half_mm: Array, space: SpaceMap | None = None
) -> NDArray[np.bool_]:
    """Whether every view sees the whole of the window about each vector, at the vector's depth."""
    if space is not None:
        sides = np.diag(half_mm)[:2]  # of its middle plane across
        corners = [at_mm + a * sides[0] + b * sides[1] for a in (-1, 1) for b in (-1, 1)]
        return np.all([_windows_seen(camera, space.to_lens(corner), 0 * half_mm) for corner in corners], axis=0)
    x, y = seen_by_every_view_mm(camera, at_mm[:, 2])
    return (np.abs(at_mm[:, 0]) + half_mm[0] <= x) & (np.abs(at_mm[:, 1]) + half_mm[1] <= y)


def _errors(measured: Array, true: Array, depth_mm: Array) -> Errors:
    """Errors of vectors (n, 3) in voxels at distances ``depth_mm`` (n,) from the focal plane."""
    answered = np.isfinite(measured).all(1)
    error = measured - true
    with np.errstate(invalid="ignore"):
        fine = answered & (np.abs(error) <= GROSS_VOXELS).all(1)
    gross = int((answered & ~fine).sum()) / max(int(answered.sum()), 1)
    error, depth = error[fine], depth_mm[fine]
    bands = []
    if len(depth):
        edges = np.quantile(depth, [0, 1 / 3, 2 / 3, 1])
        for first, last in pairwise(edges):
            inside = error[(depth >= first) & (depth <= last)]
            band = Band(float(first), float(last), len(inside), _tuple(_rms(inside)), _tuple(inside.mean(0)))
            bands.append(band)
    bias = error.mean(0) if len(error) else np.full(3, nan)
    return Errors(float(answered.mean()), gross, _tuple(_rms(error)), _tuple(bias), tuple(bands))


def _rms(error: Array) -> Array:
    return np.sqrt((error**2).mean(0)) if len(error) else np.full(3, nan)


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
