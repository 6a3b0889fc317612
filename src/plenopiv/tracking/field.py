"""A velocity field from scattered tracks: smooth as the data's own errors allow, free of divergence on request.

The field is cubic B-splines on a regular grid of nodes, as in FlowFit (Gesemann, Huhn, Schanz & Schroder 2016, 18th
Int. Symp. on Applications of Laser Techniques to Fluid Mechanics). Their coefficients minimise

    sum_i |u(x_i) - u_i|^2 / s_i^2  +  smoothing * sum |third differences|^2  +  stiffness * sum |div u|^2 ,

the last over the nodes. The smoothing is the one that tells a fifth of the tracks best from the others
(cross-validation, Wahba 1990, Spline Models for Observational Data): it needs no errors s_i of the right size, only
their ratios. Error bars are the scatter of fits to data that carry errors again, s_i or, where residuals are larger
than these, as large; to that comes what nodes and smoothing do not resolve, in a direction or in all: by how
much tracks nearby that are held out are missed by more than their errors and that scatter. The normal equations are a
band, factorised by Cholesky's method: a second for 8000 coefficients. ``parts`` takes larger volumes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import block_diag, coo_array, csr_array, eye_array, hstack, kron
from scipy.spatial import cKDTree

from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits

STIFFNESS = 1e4  # of div u against the smoothing's largest eigenvalue
REPEATS = 24  # fits to data with errors, for error bars
SMOOTHINGS = tuple(10.0**k for k in range(4, -6, -1))  # tried, relative to the data's information on a coefficient
HELD_OUT = 5  # each such track is not fitted while the smoothing is chosen ...
MANY = 600  # ... but of fewer tracks all are held out in turn
LARGEST = 16.0  # squared residual, in variances, that a track held out counts at most: wrong links
PAST = 1.02  # times the least error is past the best smoothing
RIDGE = 1e-9  # of the data's information, on every coefficient
LEAST_TRACKS = 64
TURNS = 2  # folds that what is not resolved is taken from, ...
NEARBY = 32  # ... and how many tracks of these, at a point
OUTLYING = 4.0  # standard deviations of its residual from which a track is left out of a second fit, ...
AROUND = 16  # ... of the median's of so many tracks about it, where the field resolves less than elsewhere
MEDIAN_SQUARE = 0.455  # of a normal deviate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackField:
    """Cubic B-splines. ``coefficients`` (repeats + 1, 3, n), the fit first; ``low_mm``, ``step_mm`` (3,) and ``nodes``
    (3,) along x, y, z; ``smoothing`` that was chosen; ``chi2`` per component; ``scale``: of the tracks' standard
    deviations in the error bars; ``used`` (k,): tracks not left out; ``held_mm``, ``missed`` and ``known`` (m, 3):
    where tracks are that were held out, by how much the square of what they are missed by is more than errors explain,
    (m/s)^2, and how well that is known, one over its variance."""

    coefficients: Array
    low_mm: Array
    step_mm: float
    nodes: tuple[int, int, int]
    smoothing: float
    chi2: float
    scale: float
    used: NDArray[np.bool_]
    held_mm: Array
    missed: Array
    known: Array

    def velocity(self, points_mm: ArrayLike) -> tuple[Array, Array]:
        """Velocity and its standard deviation, both (n, 3) in m/s, at points (n, 3) in mm within the grid."""
        basis = self._basis(points_mm)
        values = np.stack([basis @ each.T for each in self.coefficients])
        return values[0], np.sqrt(values[1:].var(0) + self._unresolved(points_mm))

    def _unresolved(self, points_mm: ArrayLike) -> Array:
        """Variance (n, 3) of what the field does not resolve at points: the mean over tracks nearby, of a component by
        itself or of all three, whichever is more, less its own standard error, so that noise alone adds little."""
        count = min(NEARBY, len(self.held_mm))
        near = cKDTree(self.held_mm).query(np.asarray(points_mm, np.float64), count)[1]
        missed, known = self.missed[near], self.known[near]  # (n, count, 3)
        whole = known.sum((1, 2))[:, None]
        mean = (known * missed).sum((1, 2))[:, None] / whole
        error = np.sqrt(((known * (missed - mean[:, :, None])) ** 2).sum((1, 2)))[:, None] / whole
        own = (known * missed).sum(1) / known.sum(1)
        of_own = np.sqrt(((known * (missed - own[:, None])) ** 2).sum(1)) / known.sum(1)
        return np.asarray(np.maximum(np.maximum(mean - error, own - of_own), 0.0))

    def gradient(self, points_mm: ArrayLike) -> Array:
        """du_i/dx_j (n, 3, 3) in 1/s at points (n, 3) in mm."""
        along = [1e3 * (self._basis(points_mm, axis) @ self.coefficients[0].T) for axis in range(3)]
        return np.stack(along, -1)

    def _basis(self, points_mm: ArrayLike, derivative: int | None = None) -> csr_array:
        return _basis(np.asarray(points_mm, np.float64), self.low_mm, self.step_mm, self.nodes, derivative)


def field_from_tracks(
    position_mm: ArrayLike,
    velocity_m_s: ArrayLike,
    std_m_s: ArrayLike,
    limits_mm: Limits,
    step_mm: float,
    *,
    divergence_free: bool = True,
    seed: int = 0,
) -> TrackField:
    """The field of velocities (n, 3) in m/s, with standard deviations (n, 3), of tracks at (n, 3) mm, within
    ``limits_mm``, nodes ``step_mm`` apart.

    Raises:
        PlenoPIVError: fewer tracks than a cubic has coefficients, or a step that is not positive.
    """
    position, velocity, std = (np.asarray(each, np.float64) for each in (position_mm, velocity_m_s, std_m_s))
    if len(position) < LEAST_TRACKS or not step_mm > 0:
        raise PlenoPIVError(
            f"tracking: {len(position)} tracks and nodes {step_mm:g} mm apart make no field; give {LEAST_TRACKS} "
            "tracks or more and a positive distance"
        )
    low = np.array([lo for lo, _ in limits_mm])
    counts = [max(int(np.ceil((hi - lo) / step_mm - 1e-6)), 1) + 3 for lo, hi in limits_mm]
    nodes = (counts[0], counts[1], counts[2])
    inside = ((position >= low) & (position <= [hi for _, hi in limits_mm])).all(1) & np.isfinite(velocity).all(1)
    if inside.sum() < LEAST_TRACKS:
        raise PlenoPIVError(f"tracking: {inside.sum()} tracks within {limits_mm} mm make no field; enlarge it")
    penalty = _penalty(nodes, divergence_free)
    basis = _basis(position, low, step_mm, nodes)
    used: NDArray[np.bool_] = np.asarray(inside, np.bool_)
    smoothing, error = _chosen(basis[used], velocity[used], std[used], penalty)
    around = np.flatnonzero(inside)[cKDTree(position[inside]).query(position, min(AROUND, int(inside.sum())))[1]]
    for _ in range(2):  # wrong links draw their neighbours along: these are taken back
        first = _solution(basis[used], velocity[used][None], std[used], penalty, smoothing)[0]
        left = np.abs(basis @ first.T - velocity) / std
        typical = np.maximum(np.median(left[around], 1) ** 2 / MEDIAN_SQUARE, max(error, 1.0))
        used = np.asarray(inside & (left < OUTLYING * np.sqrt(typical)).all(1), np.bool_)
    basis, velocity, std = basis[used], velocity[used], std[used]
    noise = std * np.random.default_rng(seed).standard_normal((REPEATS, *std.shape))
    found = _solution(basis, np.concatenate([velocity[None], velocity + noise]), std, penalty, smoothing)
    chi2 = float(np.mean(((basis @ found[0].T - velocity) / std) ** 2))
    followed = [basis @ (each - found[0]).T for each in found[1:]]  # the trace of what the fit makes of data
    free = 1.0 - float(np.mean(np.stack(followed) * noise / std**2))
    scale = max(chi2 / max(free, 0.1), 1.0) ** 0.5
    found[1:] = found[0] + scale * (found[1:] - found[0])
    held, missed = _missed(basis, velocity, std, penalty, smoothing, TURNS)
    spread = (scale * std[held]) ** 2 + np.stack([basis[held] @ each.T for each in found[1:]]).var(0)
    known = 1.0 / spread**2
    of_held = position[used][held], missed**2 - spread, known
    return TrackField(found, low, step_mm, nodes, smoothing, chi2, scale, used, *of_held)


def _missed(
    basis: csr_array, velocity: Array, std: Array, penalty: csr_array, smoothing: float, turns: int
) -> tuple[NDArray[np.bool_], Array]:
    """Which tracks (n,) are held out, those of the first ``turns`` folds, and by how much these (m, 3) are missed by
    the fit to the tracks of the other folds."""
    fold = np.arange(len(velocity)) % HELD_OUT  # in whatever order tracks are, all over the volume
    out = np.empty_like(velocity)
    for turn in range(turns):
        held = fold == turn
        found = _solution(basis[~held], velocity[~held][None], std[~held], penalty, smoothing)[0]
        out[held] = basis[held] @ found.T - velocity[held]
    return fold < turns, out[fold < turns]


def _chosen(basis: csr_array, velocity: Array, std: Array, penalty: csr_array) -> tuple[float, float]:
    """The smoothing that tells tracks held out best, and their squared error in variances of the tracks."""
    turns = HELD_OUT if len(velocity) < MANY else 1
    errors: list[float] = []
    for smoothing in SMOOTHINGS:
        held, missed = _missed(basis, velocity, std, penalty, smoothing, turns)
        errors.append(float(np.minimum((missed / std[held]) ** 2, LARGEST).mean()))
        if errors[-1] > PAST * min(errors):
            break
    best = int(np.argmin(errors))
    return SMOOTHINGS[best], errors[best]


def _solution(basis: csr_array, values: Array, std: Array, penalty: csr_array, smoothing: float) -> Array:
    """Coefficients (k, 3, nodes) of velocities (k, n, 3)."""
    n = basis.shape[1]
    weights = [1.0 / std[:, k] ** 2 for k in range(3)]
    data = block_diag([basis.T @ (basis * w[:, None]) for w in weights], format="csr")
    unit = float(data.diagonal().mean())
    form = (data + (smoothing * unit) * penalty + RIDGE * unit * eye_array(3 * n)).tocoo()
    place = np.arange(3 * n).reshape(n, 3).T.ravel()  # components of a node side by side: the band is narrow
    factor = cholesky_banded(_band(form, place), overwrite_ab=True, lower=True, check_finite=False)
    right = np.stack([basis.T @ (weights[k] * values[:, :, k]).T for k in range(3)], 1).reshape(3 * n, -1)
    return np.ascontiguousarray(cho_solve_banded((factor, True), right, check_finite=False).reshape(n, 3, -1).T)


def _band(form: coo_array, place: NDArray[np.int64]) -> Array:
    """The lower diagonals of a symmetric matrix whose unknown i is at ``place[i]``."""
    row, column = place[form.row], place[form.col]
    lower = row >= column
    row, column = row[lower], column[lower]
    out = np.zeros((int((row - column).max()) + 1, form.shape[0]), order="F")
    out[row - column, column] = form.data[lower]
    return out


def _basis(points: Array, low: Array, step: float, nodes: tuple[int, int, int], derivative: int | None = None):
    """Values (n, nodes) of all splines at points, or derivatives (1/mm) along an axis."""
    each = []
    for axis in range(3):
        knots = low[axis] + step * (np.arange(nodes[axis] + 4) - 3.0)
        at = np.clip(points[:, axis], knots[3] + 1e-9, knots[-4] - 1e-9)
        if derivative == axis:
            fewer = csr_array(BSpline.design_matrix(at, knots[1:-1], 2))
            before = csr_array(eye_array(nodes[axis] - 1, nodes[axis], k=1) - eye_array(nodes[axis] - 1, nodes[axis]))
            each.append(csr_array(fewer @ before) / step)
        else:
            each.append(csr_array(BSpline.design_matrix(at, knots, 3)))
    x, y, z = each
    return _rows_times(z, _rows_times(y, x))


def _rows_times(a: csr_array, b: csr_array) -> csr_array:
    """Products of all entries of each row of a with all of the same row of b: (n, columns of a * columns of b)."""
    a, b = a.tocsr(), b.tocsr()
    per_a, per_b = np.diff(a.indptr), np.diff(b.indptr)
    if len(set(per_a)) > 1 or len(set(per_b)) > 1:
        raise AssertionError("design matrices have as many entries in each row")
    n = a.shape[0]
    i, j = a.indices.reshape(n, -1), b.indices.reshape(n, -1)
    index = (i[:, :, None].astype(np.int64) * b.shape[1] + j[:, None, :]).reshape(n, -1)
    values = (a.data.reshape(n, -1)[:, :, None] * b.data.reshape(n, -1)[:, None, :]).reshape(n, -1)
    start = np.arange(n + 1) * index.shape[1]
    return csr_array((values.ravel(), index.ravel(), start), shape=(n, a.shape[1] * b.shape[1]))


@lru_cache(maxsize=2)
def _penalty(nodes: tuple[int, int, int], divergence_free: bool) -> csr_array:
    """The quadratic form (3n, 3n) of third differences, and of the divergence between the nodes."""
    nx, ny, nz = nodes
    unit = [eye_array(count) for count in (nz, ny, nx)]
    form = None
    for axis, count in enumerate((nz, ny, nx)):
        if count < 4:
            continue
        third = csr_array(np.diff(np.eye(count), 3, axis=0))
        parts = [third if a == axis else unit[a] for a in range(3)]
        each = kron(kron(parts[0], parts[1]), parts[2])
        own = each.T @ each
        form = own if form is None else form + own
    smooth = block_diag([form] * 3)
    if not divergence_free:
        return csr_array(smooth)
    middles = [(np.arange(2 * (count - 3)) + 0.5) / 2 for count in nodes]
    z, y, x = np.meshgrid(middles[2], middles[1], middles[0], indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
    divergence = hstack([_basis(points, np.zeros(3), 1.0, nodes, axis) for axis in range(3)])
    return csr_array(smooth + STIFFNESS * (divergence.T @ divergence))
