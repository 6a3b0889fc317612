"""A velocity field from scattered tracks: smooth as the data's own errors allow, free of divergence on request.

The field is cubic B-splines on a regular grid of nodes, as in FlowFit (Gesemann, Huhn, Schanz & Schroder 2016, 18th
Int. Symp. on Applications of Laser Techniques to Fluid Mechanics). Their coefficients minimise

    sum_i |u(x_i) - u_i|^2 / s_i^2  +  smoothing * sum |third differences|^2  +  stiffness * sum |div u|^2 ,

the last over the nodes. The smoothing is the largest at which the residuals are what the errors s_i say, chi^2 per
component 1 (Morozov's discrepancy principle). Its scale does not matter then. Error bars are the scatter of fits to
data that carry these errors again; what nodes or smoothing do not resolve is not in them. The normal equations are
factorised, which takes a second for 4000 coefficients of all components and grows with their number squared at least:
take parts of a large volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csr_array, eye_array, hstack, kron
from scipy.sparse.linalg import splu

from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits

STIFFNESS = 1e4  # of div u against the smoothing's largest eigenvalue
TRIALS = 10  # of the smoothing, by bisection of its logarithm
REPEATS = 24  # fits to data with errors, for error bars
WEAKEST, STRONGEST = 1e-8, 1e8  # smoothing, relative to the data's information on a coefficient
OUTLYING = 4.0  # standard deviations of its residual from which a track is left out of a second fit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackField:
    """Cubic B-splines. ``coefficients`` (repeats + 1, 3, n), the fit first; ``low_mm``, ``step_mm`` (3,) and ``nodes``
    (3,) along x, y, z; ``smoothing`` that was chosen; ``chi2`` per component; ``used`` (k,): tracks not left out."""

    coefficients: Array
    low_mm: Array
    step_mm: float
    nodes: tuple[int, int, int]
    smoothing: float
    chi2: float
    used: NDArray[np.bool_]

    def velocity(self, points_mm: ArrayLike) -> tuple[Array, Array]:
        """Velocity and its standard deviation, both (n, 3) in m/s, at points (n, 3) in mm within the grid."""
        basis = self._basis(points_mm)
        values = np.stack([basis @ each.T for each in self.coefficients])
        return values[0], values[1:].std(0)

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
    if len(position) < 64 or not step_mm > 0:
        raise PlenoPIVError(
            f"tracking: {len(position)} tracks and nodes {step_mm:g} mm apart make no field; give 64 tracks or more "
            "and a positive distance"
        )
    low = np.array([lo for lo, _ in limits_mm])
    counts = [max(int(np.ceil((hi - lo) / step_mm - 1e-6)), 1) + 3 for lo, hi in limits_mm]
    nodes = (counts[0], counts[1], counts[2])
    inside = ((position >= low) & (position <= [hi for _, hi in limits_mm])).all(1) & np.isfinite(velocity).all(1)
    penalty = _penalty(nodes, low, step_mm, divergence_free)
    basis = _basis(position, low, step_mm, nodes)
    used: NDArray[np.bool_] = np.asarray(inside, np.bool_)
    found = None
    for _ in range(2):
        found = _fitted(basis[used], velocity[used], std[used], penalty, seed)
        left = np.abs(basis @ found[0][0].T - velocity) / std
        used = np.asarray(inside & (left < OUTLYING * max(found[2], 1.0) ** 0.5).all(1), np.bool_)
    assert found is not None
    return TrackField(found[0], low, step_mm, nodes, found[1], found[2], used)


def _fitted(basis: csr_array, velocity: Array, std: Array, penalty: csr_array, seed: int) -> tuple[Array, float, float]:
    """Coefficients (repeats + 1, 3, n), smoothing and chi^2 per component."""
    n = basis.shape[1]
    weights = [1.0 / std[:, k] ** 2 for k in range(3)]
    data = block_diag([basis.T @ (basis * w[:, None]) for w in weights], format="csc")
    unit = float(data.diagonal().mean())

    def solved(smoothing: float, values: list[Array]) -> tuple[list[Array], float]:
        factor = splu((data + (smoothing * unit) * penalty + 1e-9 * unit * eye_array(3 * n)).tocsc())
        found = []
        for each in values:
            right = np.concatenate([basis.T @ (weights[k] * each[:, k]) for k in range(3)])
            found.append(factor.solve(right).reshape(3, n))
        chi2 = float(np.mean(((basis @ found[0].T - values[0]) / std) ** 2))
        return found, chi2

    low, high = np.log(WEAKEST), np.log(STRONGEST)
    for _ in range(TRIALS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if solved(float(np.exp(middle)), [velocity])[1] > 1.0 else (middle, high)
    rng = np.random.default_rng(seed)
    again = [velocity + std * rng.standard_normal(std.shape) for _ in range(REPEATS)]
    found, chi2 = solved(float(np.exp(low)), [velocity, *again])
    return np.stack(found), float(np.exp(low)), chi2


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


def _penalty(nodes: tuple[int, int, int], low: Array, step: float, divergence_free: bool) -> csr_array:
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
    middles = [low[a] + step * (np.arange(2 * (count - 3)) + 0.5) / 2 for a, count in enumerate(nodes)]
    z, y, x = np.meshgrid(middles[2], middles[1], middles[0], indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
    divergence = hstack([_basis(points, low, step, nodes, axis) * step for axis in range(3)])
    return csr_array(smooth + STIFFNESS * (divergence.T @ divergence))
