"""A velocity field from scattered tracks: smooth as the data's own errors allow, free of divergence on request.

The field is cubic B-splines on a regular grid of nodes, as in FlowFit (Gesemann, Huhn, Schanz & Schroder 2016, 18th
Int. Symp. on Applications of Laser Techniques to Fluid Mechanics). Their coefficients (``splines``) minimise

    sum_i |u(x_i) - u_i|^2 / (s_i^2 + f^2)  +  smoothing * sum |third differences|^2  +  stiffness * sum |div u|^2 ,

the last over the nodes; s_i are the errors of the tracks, f what splines do not resolve, from what a first fit misses
the tracks nearby by. Without f tracks that are known well would be believed to stand for the flow about them, against
all others: near focus, where few are. The smoothing is a little less than the one that tells a fifth of the tracks best
from the others (cross-validation, Wahba 1990, Spline Models for Observational Data). What splines leave beyond errors
is added, interpolated between tracks (``remainder``). Error bars are the scatter of fits to data that carry errors
again, and what noise makes of the remainder, no less and no more than tracks held out allow (``unresolved``).
``parts`` takes larger volumes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.nearby import Smoothings, Solved
from plenopiv.tracking.remainder import LEAST, MEDIAN_SQUARE, Remainder
from plenopiv.tracking.splines import Equations, Nodes, information, values_at
from plenopiv.tracking.unresolved import Unresolved
from plenopiv.volume import Limits, check_limits, within

REPEATS = 24  # fits to data with errors, for error bars
SMOOTHINGS = -5.0, 4.0  # powers of ten that are tried, relative to the data's information on a coefficient ...
USUAL = -2.0  # ... from this one downhill
UNDER = 0.5  # powers of ten by which the best one is undercut: its bias is as large as the scatter, and in no error bar
HELD_OUT = 5  # each such track is not fitted while the smoothing is chosen ...
MANY = 600  # ... but of fewer tracks all are held out in turn
LARGEST = 16.0  # squared residual, in variances, that a track held out counts at most: wrong links
LEAST_TRACKS = 64
TURNS = 2  # folds that error bars are taken from
OUTLYING = 4.0  # standard deviations of its error from which on a residual leaves its track out, ...
OF_UNRESOLVED = 8.0  # ... and of what is not resolved, which has tails, by residuals of ...
AROUND = 16  # ... the tracks about it
THIN = 1e-3  # of a cell, the scatter across a plane: of splines beyond it next to nothing is known, nor said by bars
CHANCE = 1.5  # times its true value that a variance by the median of AROUND residuals exceeds in one case of five

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackField:
    """Cubic B-splines and what these leave. ``coefficients`` (repeats + 1, 3, n), the fit first; ``low_mm``,
    ``step_mm`` (3,) and ``nodes`` (3,) along x, y, z; ``smoothing`` that was chosen; ``chi2`` per degree of freedom,
    what is not resolved counted as an error; ``scale``: of such errors in the error bars; ``used`` (k,): tracks not
    left out; ``remainder``: what splines leave of the tracks; ``unresolved``: and what both leave of others."""

    coefficients: Array
    low_mm: Array
    step_mm: float
    nodes: tuple[int, int, int]
    smoothing: float
    chi2: float
    scale: float
    used: NDArray[np.bool_]
    remainder: Remainder
    unresolved: Unresolved

    def velocity(self, points_mm: ArrayLike) -> tuple[Array, Array]:
        """Velocity and its standard deviation, both (n, 3) in m/s, at points (n, 3) in mm within the grid."""
        points = np.asarray(points_mm, np.float64)
        basis = self._basis(points)
        values = np.stack([basis @ each.T for each in self.coefficients])
        left, chance, untold = self.remainder.at(points)
        finer = self.unresolved.at(points, chance / np.maximum(untold, LEAST))  # what noise adds is an error, too
        return values[0] + left, np.sqrt(values[1:].var(0, ddof=1) + untold * finer)

    def gradient(self, points_mm: ArrayLike) -> Array:
        """du_i/dx_j (n, 3, 3) in 1/s of the splines at points (n, 3) in mm, without what is added to them."""
        along = [1e3 * (self._basis(points_mm, axis) @ self.coefficients[0].T) for axis in range(3)]
        return np.stack(along, -1)

    def _basis(self, points_mm: ArrayLike, derivative: int | None = None) -> csr_array:
        return values_at(np.asarray(points_mm, np.float64), self.low_mm, self.step_mm, self.nodes, derivative)


def field_from_tracks(
    position_mm: ArrayLike,
    velocity_m_s: ArrayLike,
    std_m_s: ArrayLike,
    limits_mm: Limits,
    step_mm: float,
    *,
    divergence_free: bool = True,
    seed: int = 0,
    core_mm: Limits | None = None,
) -> TrackField:
    """The field of velocities (n, 3) in m/s, with standard deviations (n, 3), of tracks at (n, 3) mm, within
    ``limits_mm``, nodes ``step_mm`` apart. ``core_mm``: where there are enough tracks in it, these alone choose the
    smoothing, which takes several factors: those of half the nodes cost a fifth. Tracks with a number that is not
    finite are left out.

    Raises:
        PlenoPIVError: fewer tracks than a cubic has coefficients, or all in a plane or in another small part of the
            volume; a standard deviation or a step that is not positive.
    """
    position, velocity, std = (np.asarray(each, np.float64) for each in (position_mm, velocity_m_s, std_m_s))
    known = known_tracks(position, velocity, std)
    check_limits("tracking", limits_mm)
    if len(position) < LEAST_TRACKS or not step_mm > 0:
        raise PlenoPIVError(
            f"tracking: {len(position)} tracks and nodes {step_mm:g} mm apart make no field; give {LEAST_TRACKS} "
            "tracks or more and a positive distance"
        )
    low, nodes = _nodes(limits_mm, step_mm)
    inside = np.asarray(((position >= low) & (position <= [hi for _, hi in limits_mm])).all(1) & known, np.bool_)
    if inside.sum() < LEAST_TRACKS:
        raise PlenoPIVError(f"tracking: {inside.sum()} tracks within {limits_mm} mm make no field; enlarge it")
    _check_scatter(position[inside], limits_mm, step_mm)
    position, velocity, std = (each[inside] for each in (position, velocity, std))
    values, used = values_at(position, low, step_mm, nodes), np.ones(len(position), np.bool_)
    form, core = (nodes, divergence_free), core_mm or limits_mm

    def chosen(std: Array, start: float) -> tuple[float, float]:
        """A smoothing, looked for from a power of ten, and the power that another one is looked for from."""
        of_all = information(values[used], std[used])
        own = used & within(position, core)
        if core == limits_mm or own.sum() < MANY:
            own, of_tracks, of_nodes = used, values[used], nodes
        else:
            of_core, of_nodes = _nodes(core, step_mm)
            of_tracks = values_at(position[own], of_core, step_mm, of_nodes)
        best = _chosen(of_tracks, velocity[own], std[own], of_nodes, divergence_free, start)
        share = information(of_tracks, std[own]) / of_all
        return share * 10.0 ** (best - UNDER), float(np.clip(np.floor(best), *SMOOTHINGS))

    (smoothing, start), whole = chosen(std, USUAL), std
    around = cKDTree(position).query(position, min(AROUND, len(position)))[1]
    fit = Solved(Equations(values, std, *form), velocity[None], smoothing)
    first = fit.coefficients[0]
    for again in (True, False):  # wrong links draw their neighbours along: these are taken back
        missed = np.abs(values @ first.T - velocity)
        usual = np.median(missed[around], 1) ** 2 / MEDIAN_SQUARE
        finer = np.maximum(usual - CHANCE * np.median(std[around], 1) ** 2, 0.0)  # than nodes
        most = np.sqrt(OUTLYING**2 * std**2 + OF_UNRESOLVED**2 * finer)
        whole, used = np.sqrt(std**2 + finer), np.asarray((missed < most).all(1), np.bool_)
        if again:
            smoothing, _ = chosen(whole, start)
            of_used = Equations(values, np.where(used[:, None], whole, np.inf), *form)
            first = fit.nearby(of_used, velocity, smoothing)
    _check_scatter(position[used], limits_mm, step_mm)
    position, values, velocity, std, whole = (each[used] for each in (position, values, velocity, std, whole))
    noise = whole * np.random.default_rng(seed).standard_normal((REPEATS, *std.shape))
    fit = Solved(Equations(values, whole, *form), np.concatenate([velocity[None], velocity + noise]), smoothing)
    found = fit.coefficients
    chi2 = float(np.mean(((values @ found[0].T - velocity) / whole) ** 2))
    followed = [values @ (each - found[0]).T for each in found[1:]]  # the trace of what the fit makes of data
    free = max(1.0 - float(np.mean(np.stack(followed) * noise / whole**2)), 0.1)
    scale = max(chi2 / free, 1.0) ** 0.5
    found[1:] = found[0] + scale * (found[1:] - found[0])
    spacing = float(np.prod([hi - lo for lo, hi in limits_mm]) / len(std)) ** (1 / 3)

    def remainder(coefficients: Array, some: NDArray[np.bool_]) -> Remainder:
        left = velocity[some] - values[some] @ coefficients.T
        return Remainder(position[some], left, free * std[some] ** 2, spacing)

    off, untold, any_held = np.empty_like(std), np.empty_like(std), np.zeros(len(std), bool)
    for held, equations in _folds(values, whole, *form, TURNS):
        fitted = fit.nearby(equations, velocity, smoothing)
        added, _, untold[held] = remainder(fitted, ~held).at(position[held])
        off[held] = values[held] @ fitted.T + added - velocity[held]
        any_held |= held
    explained = std[any_held] ** 2 + np.stack([values[any_held] @ each.T for each in found[1:]]).var(0, ddof=1)
    left_over = Unresolved(position[any_held], off[any_held] ** 2, explained, untold[any_held])
    of_all = remainder(found[0], np.ones(len(std), bool))
    inside[inside] = used
    return TrackField(found, low, step_mm, nodes, smoothing, chi2 / free, scale, inside, of_all, left_over)


def known_tracks(position_mm: Array, velocity_m_s: Array, std_m_s: Array) -> NDArray[np.bool_]:
    """Tracks (n,) whose positions, velocities and standard deviations (n, 3) are all finite.

    Raises:
        PlenoPIVError: one of these has a standard deviation that is not positive; arrays of other shapes.
    """
    shapes = {each.shape for each in (position_mm, velocity_m_s, std_m_s)}
    if len(shapes) > 1 or position_mm.ndim != 2 or position_mm.shape[1] != 3:
        raise PlenoPIVError(f"tracking: positions, velocities and std of shapes {sorted(shapes)}, give (n, 3) of each")
    known = np.isfinite(np.concatenate([position_mm, velocity_m_s, std_m_s], 1)).all(1)
    wrong = np.flatnonzero(known & (std_m_s <= 0).any(1))
    if len(wrong):
        raise PlenoPIVError(
            f"tracking: std_m_s of track {wrong[0]} is {std_m_s[wrong[0]].min():g}, a standard deviation is positive; "
            "leave out tracks whose error is not known"
        )
    return np.asarray(known, np.bool_)


def _check_scatter(position: Array, limits_mm: Limits, step_mm: float) -> None:
    """Raise PlenoPIVError where tracks at ``position`` (n, 3) lie in a plane, or on a line, of a volume that is deeper
    than a cell across it."""
    variance, directions = np.linalg.eigh(np.cov(position.T))
    across = np.abs(directions.T) @ [hi - lo for lo, hi in limits_mm]  # of the volume, along each
    if ((np.sqrt(np.maximum(variance, 0.0)) < THIN * step_mm) & (across > step_mm)).any():
        raise PlenoPIVError(
            f"tracking: {len(position)} tracks in a plane or on a line make no field of all of {limits_mm} mm; "
            "make limits_mm no wider across it than step_mm"
        )


def _nodes(limits_mm: Limits, step_mm: float) -> tuple[Array, Nodes]:
    """Where a grid of nodes ``step_mm`` apart begins (3,), and how many there are."""
    counts = [max(int(np.ceil((hi - lo) / step_mm - 1e-6)), 1) + 3 for lo, hi in limits_mm]
    return np.array([lo for lo, _ in limits_mm]), (counts[0], counts[1], counts[2])


def _folds(
    values: csr_array, std: Array, nodes: Nodes, divergence_free: bool, turns: int
) -> list[tuple[NDArray[np.bool_], Equations]]:
    """Which tracks (n,) are held out in each of ``turns`` folds, and the equations of the others."""
    fold = np.arange(len(std)) % HELD_OUT  # in whatever order tracks are, all over the volume
    held = [fold == turn for turn in range(turns)]
    return [(each, Equations(values, np.where(each[:, None], np.inf, std), nodes, divergence_free)) for each in held]


def _chosen(values: csr_array, velocity: Array, std: Array, nodes: Nodes, divergence_free: bool, start: float) -> float:
    """The power of ten of the smoothing that tells tracks held out best, looked for from a ``start``."""
    folds = _folds(values, std, nodes, divergence_free, HELD_OUT if len(velocity) < MANY else 1)
    fits = [(held, values[held], Smoothings(equations, velocity)) for held, equations in folds]
    errors: dict[float, float] = {}

    def error(power: float) -> float:
        """With a smoothing of 10 to the ``power``."""
        if power not in errors:
            try:
                missed = [(at @ fit.solution(10.0**power).T - velocity[held]) / std[held] for held, at, fit in fits]
                errors[power] = float(np.minimum(np.concatenate(missed) ** 2, LARGEST).mean())
            except PlenoPIVError:  # so smooth that the tracks' information is below rounding
                errors[power] = np.inf
        return errors[power]

    best = start
    step = 1.0 if error(best + 1.0) < error(best) else -1.0
    while SMOOTHINGS[0] <= best + step <= SMOOTHINGS[1] and error(best + step) < error(best):
        best += step
    best = min((best - 0.5, best, best + 0.5), key=error)
    return best
