"""The variants that are compared, as data: solver, start, weights, pixels, and the iterations that are judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from pixel_sequential import pixel_sequential
from variants import (
    golden_order,
    half_of_the_views,
    one_random_order,
    random_order,
    raster_order,
    rim_first,
    simultaneous,
    view_sequential,
)

FEW, MANY, SLOW = (1, 2, 3, 5), (1, 2, 3, 5, 10), (1, 2, 5, 10, 20)


@dataclass(frozen=True)
class Case:
    """One variant. ``solver`` makes a fresh generator function, so that each frame draws the same orders.

    ``start``: "uniform", "product", "product^8" or "least" over the candidates, or "everywhere": uniform over all
    voxels. ``work``: what one iteration costs in iterations over all views. ``seeds``: how many recordings it is run
    on, each with other particles. ``tolerance_px``: of the candidates.
    """

    group: str
    name: str
    solver: Callable[[], Callable[..., Any]]
    weights: str = "exact"
    start: str = "uniform"
    pixels: Literal["raw", "resampled", "raw where resampled"] = "raw"
    rounds: tuple[int, ...] = FEW
    conditions: tuple[str, ...] = ("pair", "alone")
    work: float = 1.0
    seeds: int = 1
    tolerance_px: float = 3.0


def views(*mu: float, **settings) -> Callable[[], Callable[..., Any]]:
    """View-sequential with the exponents ``mu`` of the iterations."""
    return lambda: partial(view_sequential, relaxation=mu or (0.3,), **settings)


def every(*mu: float, **settings) -> Callable[[], Callable[..., Any]]:
    """Simultaneous."""
    return lambda: partial(simultaneous, relaxation=mu, **settings)


def pixels(*mu: float, **settings) -> Callable[[], Callable[..., Any]]:
    """Pixel-sequential."""
    return lambda: partial(pixel_sequential, relaxation=mu, **settings)


ALL = ("pair", "dim", "alone")
DEFAULT = "view-sequential, mu 0.3"
CASES = (
    Case("algorithm", DEFAULT, views(0.3), rounds=MANY, conditions=ALL),
    Case("algorithm", "view-sequential as powers, mu 0.3", views(0.3, form="powers")),
    Case("algorithm", "pixel-sequential, views in order, mu 0.3", pixels(0.3), rounds=FEW),
    Case("algorithm", "pixel-sequential, pixels shuffled, mu 0.3", pixels(0.3, shuffled=True), rounds=FEW),
    Case("algorithm", "simultaneous as powers (SMART), mu 1", every(1.0), rounds=SLOW, conditions=ALL),
    Case("algorithm", "simultaneous as powers (SMART), mu 3", every(3.0), rounds=SLOW),
    Case("algorithm", "simultaneous as sums (ML-EM), mu 1", every(1.0, form="sums"), rounds=SLOW),
    Case("relaxation", "mu 0.1", views(0.1), conditions=ALL),
    Case("relaxation", "mu 1", views(1.0), conditions=ALL),
    Case("relaxation", "mu 1, 0.3, 0.1 by iteration", views(1.0, 0.3, 0.1), rounds=FEW, conditions=ALL),
    Case("relaxation", "mu 0.6, 0.2, 0.07 by iteration", views(0.6, 0.2, 0.07), rounds=FEW, conditions=ALL),
    Case("relaxation", "mu 0.3, 0.1, 0.03 by iteration", views(0.3, 0.1, 0.03), rounds=FEW, conditions=ALL),
    Case("order", "one random order for all iterations", views(order=one_random_order)),
    Case("order", "raster", views(order=raster_order)),
    Case("order", "rim first", views(order=rim_first)),
    Case("order", "golden steps", views(order=golden_order)),
    Case("order", "a random half of the views in each iteration", lambda: views(order=half_of_the_views())(), work=0.5),
    Case("order", "another seed of the random order", lambda: views(order=random_order(1))()),
    Case("start", "product of the views (MFG)", views(), start="product"),
    Case("start", "product of the views, 8th power", views(), start="product^8"),
    Case("start", "least of the views", views(), start="least"),
    Case("start", "uniform, candidates by a tolerance of 6 px", views(), tolerance_px=6.0),
    Case("start", "uniform over all voxels, no candidates", views(), start="everywhere", rounds=(1, 3)),
    Case("weights", "1 ray", views(), weights="1-ray"),
    Case("weights", "9 rays", views(), weights="9-rays"),
    Case("pixels", "resampled views, exact weights", views(), pixels="resampled", conditions=ALL),
    Case("pixels", "raw pixels where resampled views have a value", views(), pixels="raw where resampled"),
    Case("pixels", "resampled views, 1 ray", views(), pixels="resampled", weights="1-ray"),
)
