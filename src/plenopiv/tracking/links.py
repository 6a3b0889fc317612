"""Which particle of one frame is which of the next: links.

A predictor, the displacement that correlation found, says where a particle of the first frame is to be looked for. What
it leaves, flow that a window does not resolve and its own errors, is learnt from the links themselves: its scatter over
the volume, and where enough neighbours are linked its trend around each particle. A pair costs

    d^T (C_a + C_b + S)^-1 d + (ln light ratio)^2 / variance,

d the distance from the predicted place, C the covariances of both positions, S the scatter. All links together are the
cheapest assignment, one to one, where not to link costs GATE (Kuhn 1955). A link is left out where another partner
would have cost little more, or where it departs from its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.reconstruction.noise import MAD_TO_STD
from plenopiv.tracking.assignment import cheapest_partners
from plenopiv.tracking.frame import FrameParticles

GATE = 25.0  # cost of a particle that is not linked: 4 degrees of freedom exceed it once in 20,000
CLEAR = 6.0  # by which another partner must cost more than the one that is taken
PASSES = 3
NEIGHBOURS = 20  # linked particles around, whose departures from the predictor tell a particle's own
WIDE = 9.0  # times the median of variances
LEAST_LOCAL = 0.5  # of the scatter over all particles that it has about each
RIDGE = 0.5  # of slopes against neighbours: fewer than some of them on one side make no slope
LOCAL, LOCAL_STD = 0.8, 1.28  # so many of a particle's neighbours depart less; the standard deviations of a normal one
COVERED, COVERED_STD = 0.95, 1.96  # the scatter is that of a normal distribution with the same 95 %
AT_A_TIME = 1000  # particles whose candidates are held
LIGHT_STD = 0.1  # of ln light between frames beyond the covariances: light sheets are not quite even

Array = NDArray[np.float64]
Int = NDArray[np.int64]
Predictor = Callable[[Array], Array]


@dataclass(frozen=True)
class Links:
    """Particle ``a[k]`` of one frame is ``b[k]`` of the next. ``cost`` (k,), ``scatter_mm`` (3,): standard deviation of
    what the predictor leaves."""

    a: Int
    b: Int
    cost: Array
    scatter_mm: Array


def link(
    first: FrameParticles, second: FrameParticles, displacement_mm: Predictor, scatter_mm: Array, most_mm: float
) -> Links:
    """Link the particles of two frames.

    ``displacement_mm``: of points (n, 3) mm at mid-time (n, 3) mm; ``scatter_mm`` (3,): a first guess of how far
    particles may be from where it says, one standard deviation; ``most_mm``: the largest displacement of a particle.
    Particles of which something is not known, or the displacement, are not linked.
    """
    if len(first.light) == 0 or len(second.light) == 0:
        nothing = np.empty(0, np.int64)
        return Links(nothing, nothing, np.empty(0), np.asarray(scatter_mm, np.float64))
    known, known_b = np.flatnonzero(_known(first)), np.flatnonzero(_known(second))
    predicted = predicted_displacements(first.position_mm[known], displacement_mm)
    known = known[np.isfinite(predicted).all(1)]
    if len(known) < len(first.light) or len(known_b) < len(second.light):
        found = link(first.of(known), second.of(known_b), displacement_mm, scatter_mm, most_mm)
        return replace(found, a=known[found.a], b=known_b[found.b])
    scatter, departure = np.asarray(scatter_mm, np.float64), np.zeros_like(predicted)
    local = np.broadcast_to(scatter, predicted.shape)
    ratio = _ratio_of_light(first, second)
    found = Links(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), scatter)
    for _ in range(PASSES):
        found = replace(cheapest(first, second, predicted + departure, local, ratio, most_mm), scatter_mm=scatter)
        if len(found.a) <= NEIGHBOURS + 1:
            return found
        left = second.position_mm[found.b] - first.position_mm[found.a] - predicted[found.a]
        departure = of_neighbours(first.position_mm, found.a, left)
        own = np.abs(left - departure[found.a])
        noise = np.einsum("nii->ni", first.covariance[found.a] + second.covariance[found.b])[:, :3]
        scatter, local = scatter_about(first.position_mm, found.a, own, noise)
    return found


def _known(particles: FrameParticles) -> NDArray[np.bool_]:
    """Which particles (n,) have finite places and covariances, and light that is positive and finite."""
    finite = np.isfinite(particles.position_mm).all(1) & np.isfinite(particles.covariance).all((1, 2))
    return np.asarray(finite & (particles.light > 0) & np.isfinite(particles.light), np.bool_)


def predicted_displacements(position_mm: Array, displacement_mm: Predictor) -> Array:
    """How far (n, 3) mm particles at ``position_mm`` (n, 3) of the first frame move, of a predictor that is known at
    the middle of the way."""
    predicted = np.zeros_like(position_mm)
    for _ in range(3):
        predicted = displacement_mm(position_mm + 0.5 * predicted)
    return predicted


def scatter_about(position: Array, linked: Int, departure: Array, variance: Array) -> tuple[Array, Array]:
    """Scatter beyond errors of particles that are ``linked`` (k,), of all (3,) and about each one at ``position``
    (n, 3): of its linked neighbours, at least half of all. ``departure`` (k, 3): size of what was not expected;
    ``variance`` (k, 3): of its errors."""
    spread = (np.quantile(departure, COVERED, 0) / COVERED_STD) ** 2 - np.median(variance, 0)
    scatter = np.sqrt(np.maximum(spread, 0.0) + 1e-12)
    _, near = cKDTree(position[linked]).query(position, min(NEIGHBOURS, len(linked)))
    usual = np.quantile((departure**2 - variance)[near], LOCAL, 1) / LOCAL_STD**2
    return scatter, np.sqrt(np.maximum(usual, (LEAST_LOCAL * scatter) ** 2))


def _ratio_of_light(first: FrameParticles, second: FrameParticles) -> float:
    """Logarithm of the second pulse's light over the first's."""
    return float(np.log(np.median(second.light) / np.median(first.light)))


def of_neighbours(position: Array, linked: Int, left: Array) -> Array:
    """What ``left`` (k, 3) of the particles ``linked`` (k,) lets expect of each one at ``position`` (n, 3): a linear
    fit through those of its linked neighbours, itself left out, in which outlying ones count less."""
    _, near = cKDTree(position[linked]).query(position, min(NEIGHBOURS + 1, len(linked)))
    off = position[linked][near] - position[:, None]
    size = np.sqrt((off**2).mean((1, 2), keepdims=True)) + 1e-12
    terms = np.concatenate([np.ones((*off.shape[:2], 1)), off / size], 2)
    values, weight = left[near], (linked[near] != np.arange(len(position))[:, None]).astype(np.float64)[:, :, None]
    believed = np.broadcast_to(weight, values.shape)
    ridge = np.diag([1e-9, *[RIDGE] * 3])
    out = np.zeros_like(position)
    for _ in range(3):
        for axis in range(3):
            w = believed[:, :, axis]
            normal = np.einsum("nka,nk,nkb->nab", terms, w, terms) + ridge
            fit = np.linalg.solve(normal, np.einsum("nka,nk,nk->na", terms, w, values[:, :, axis])[:, :, None])
            out[:, axis] = fit[:, 0, 0]
            missed = np.abs(values[:, :, axis] - (terms @ fit)[:, :, 0])
            usual = MAD_TO_STD * np.median(missed, 1, keepdims=True) + 1e-12
            believed = believed.copy()
            believed[:, :, axis] = weight[:, :, 0] / np.maximum(missed / (2.0 * usual), 1.0)
    return out


def cheapest(
    first: FrameParticles, second: FrameParticles, expected: Array, scatter: Array, ratio: float, most_mm: float
) -> Links:
    """The cheapest links to where particles are ``expected`` to be displaced by (n, 3) mm, up to ``scatter`` (n, 3) mm;
    ``ratio``: logarithm of the second frame's light over the first's."""
    a, b = _within(first, second, expected, scatter)
    moved = second.position_mm[b] - first.position_mm[a]
    covariance = first.covariance[a][:, :3, :3] + second.covariance[b][:, :3, :3]
    covariance[:, range(3), range(3)] += scatter[a] ** 2
    off = moved - expected[a]
    cost = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[:, :, None])[:, :, 0])
    brighter = np.log(second.light[b] / first.light[a]) - ratio
    relative = first.covariance[a, 3, 3] / first.light[a] ** 2 + second.covariance[b, 3, 3] / second.light[b] ** 2
    cost += brighter**2 / (relative + LIGHT_STD**2)
    kept = (cost < GATE) & ((moved**2).sum(1) <= most_mm**2)
    a, b, cost = a[kept], b[kept], cost[kept]
    n, m = len(first.light), len(second.light)
    if len(a) == 0:
        return Links(a, b, cost, scatter)
    partner = cheapest_partners(a, b, cost, n, m, GATE)
    chosen = partner[a] == b
    clear = _clear(a, b, cost, chosen, n, m)
    a, b, cost = a[chosen & clear], b[chosen & clear], cost[chosen & clear]
    return Links(a, b, cost, scatter)


def _within(first: FrameParticles, second: FrameParticles, expected: Array, scatter: Array) -> tuple[Int, Int]:
    """Pairs that may cost less than the gate: each axis within sqrt(GATE) standard deviations. The few particles that
    are known far worse than others, near focus, are looked for with a reach of their own."""
    place, other = first.position_mm + expected, second.position_mm
    variance_a = scatter**2 + np.einsum("nii->ni", first.covariance)[:, :3]
    variance_b = np.einsum("nii->ni", second.covariance)[:, :3]
    wide_a, wide_b = ((each > WIDE * np.median(each, 0)).any(1) for each in (variance_a, variance_b))
    found = []
    for of_a, of_b, by_a in ((~wide_a, ~wide_b, True), (wide_a, wide_b | True, True), (~wide_a, wide_b, False)):
        a, b = np.flatnonzero(of_a), np.flatnonzero(of_b)
        if not len(a) or not len(b):
            continue
        if by_a:
            near = _near(place[a], variance_a[a] + variance_b[b].max(0), other[b])
        else:
            near = ((m, n) for n, m in _near(other[b], variance_b[b] + variance_a[a].max(0), place[a]))
        for of_m, of_n in near:
            m, n = a[of_m], b[of_n]
            close = ((other[n] - place[m]) ** 2 <= GATE * (variance_a[m] + variance_b[n])).all(1)
            found.append((m[close], n[close]))
    a, b = (np.concatenate(each) for each in zip(*found, strict=True))
    return a, b


def _near(place: Array, variance: Array, other: Array) -> Iterator[tuple[Int, Int]]:
    """Which of ``place`` (n, 3) may have which of ``other`` (m, 3) within the gate of their ``variance`` (n, 3), some
    places at a time: where one knows next to nothing of a depth there are thousands."""
    reach = np.sqrt(GATE * variance)
    unit = np.median(reach, 0)
    tree, radius = cKDTree(other / unit), (reach / unit).max(1)
    for low in range(0, len(place), AT_A_TIME):
        some = slice(low, low + AT_A_TIME)
        near = tree.query_ball_point(place[some] / unit, radius[some], p=np.inf)
        counts = [len(each) for each in near]
        yield (
            np.repeat(low + np.arange(len(counts)), counts),
            np.fromiter(chain.from_iterable(near), np.int64, sum(counts)),
        )


def _clear(a: Int, b: Int, cost: Array, chosen: NDArray[np.bool_], n: int, m: int) -> NDArray[np.bool_]:
    """Of each candidate, whether all others of both its particles cost CLEAR more, with what the partners that these
    have would then lose: each takes what is left over, as where two exchange theirs, or stays alone."""
    of_a, of_b, taken = np.full(n, -1), np.full(m, -1), np.zeros(n)
    of_a[a[chosen]], of_b[b[chosen]], taken[a[chosen]] = b[chosen], a[chosen], cost[chosen]
    rest = ~chosen
    first, second, instead = a[rest], b[rest], cost[rest]
    left_a, left_b = of_b[second], of_a[first]  # who loses whom
    found = _cost_of(a, b, cost, left_a, left_b, m)
    alone = np.where(left_a >= 0, np.minimum(found, GATE) - taken[left_a], 0.0)
    other_a, other_b = np.full(n, GATE), np.full(m, GATE)
    np.minimum.at(other_a, first, instead + alone)
    alone = np.where(left_b >= 0, np.minimum(found, GATE) - taken[first], 0.0)
    np.minimum.at(other_b, second, instead + alone)
    return np.asarray(np.minimum(other_a[a], other_b[b]) > cost + CLEAR)


def _cost_of(a: Int, b: Int, cost: Array, first: Int, second: Int, m: int) -> Array:
    """The costs of the candidates ``first`` and ``second``; the gate where they are none, or there is no such
    particle."""
    key = a * m + b
    order = np.argsort(key)
    wanted = np.where((first >= 0) & (second >= 0), first * m + second, -1)
    at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
    return np.where(key[at] == wanted, cost[at], GATE)
