"""Areas of the plane, whose particles are treated together: cost and memory grow linearly with a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.threads import in_turn

TOGETHER = 2000  # particles, at most
AT_ONCE = 8  # areas fitted at once, at most
CUTS = 0.5, 0.4  # share of an area's particles on the one side of its cut, in turn
BITS = 16  # of places along each side, by which points are ordered
ABOUT = 50.0  # units about an area within which particles may be coupled with its own: farther ones are hardly

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


def areas(place: Array, turn: int = 0, most: int | None = None) -> list[Numbers]:
    """Points at ``place`` (n, 2) in areas of ``most``, or TOGETHER, at the most, the numbers of each ascending: cut
    along the longer side until that is so. ``turn``: areas of the next one are cut elsewhere."""
    most = TOGETHER if most is None else most
    if not len(place):
        return []
    large, small, cut = [np.arange(len(place))], list[Numbers](), CUTS[turn % len(CUTS)]
    while large:
        area = large.pop()
        if len(area) <= most:
            small.append(area)
            continue
        axis = int(np.argmax(np.ptp(place[area], axis=0)))
        order = np.argsort(place[area, axis], kind="stable")
        large += [np.sort(area[part]) for part in np.split(order, [round(cut * len(order))])]
    return small


def in_order(place: Array) -> Numbers:
    """The numbers of points at ``place`` (n, 2) in an order in which neighbours are near each other (Morton's): what
    they share is then still in the processor's cache."""
    steps = ((place - place.min(0)) / max(float(np.ptp(place, axis=0).max()), 1e-30) * (2**BITS - 1)).astype(np.int64)
    key = np.zeros(len(place), np.int64)
    for bit in range(BITS):
        key |= (steps[:, 0] >> bit & 1) << 2 * bit | (steps[:, 1] >> bit & 1) << 2 * bit + 1
    return np.argsort(key, kind="stable")


def groups(place: Array, cut: list[Numbers], apart: Array) -> list[list[Numbers]]:
    """Areas of points at ``place`` (n, 2) that may be fitted at once: AT_ONCE at most, ``apart`` (2,) or farther from
    each other along one axis at least. Of two that touch each would make up for what both leave, and the light there
    would be taken twice. What a group is does not depend on the number of threads."""
    low, high = (np.array([edge(place[area], 0) for area in cut]) for edge in (np.min, np.max))
    found = list[list[int]]()
    for k in in_turn(len(cut)):
        for group in found:
            far = (np.maximum(low[k] - high[group], low[group] - high[k]) >= apart).any(1)
            if len(group) < AT_ONCE and far.all():
                group.append(int(k))
                break
        else:
            found.append([int(k)])
    return [[cut[k] for k in group] for group in found]


def about(place: Array, area: Numbers, reach: Array) -> Numbers:
    """The points at ``place`` (n, 2) within ``reach`` (2,) of an ``area``, its own included, ascending."""
    low, high = place[area].min(0) - reach, place[area].max(0) + reach
    return np.flatnonzero(((place >= low) & (place <= high)).all(1))
