"""Limits of colours from the data: which map a variable takes, and between which values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BOTH_SIGNS = 0.1  # of the larger side at least, for colours about zero
OUTER = (0.5, 99.5)  # percentiles: a few wild vectors must not fade all others
OF_SPEED = 0.05  # of the largest speed a component's limits span at least: noise of a constant one is no pattern
LEAST = 1e-3  # of the values themselves


def colour_limits(
    values: NDArray, least_span: float = 0.0, outer: tuple[float, float] = OUTER
) -> tuple[str, float, float]:
    """(map, low, high) for ``values``, whose NaN do not count.

    "diverging" about zero where both signs occur, else "sequential": from zero where the values come near it, else over
    the values alone. Limits are at least ``least_span`` apart, so that constant values lie in the middle.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "sequential", 0.0, 1.0
    low, high = (float(limit) for limit in np.percentile(finite, outer))
    if low < 0 < high and min(-low, high) >= BOTH_SIGNS * max(-low, high):
        reach = max(-low, high, 0.5 * least_span)
        return "diverging", -reach, reach
    span = max(least_span, LEAST * max(abs(low), abs(high))) or 1.0
    if high - low < span:
        middle = 0.5 * (low + high)
        low, high = middle - 0.5 * span, middle + 0.5 * span
        return ("diverging" if abs(middle) < 0.25 * span else "sequential"), low, high
    if 0 < low < 0.5 * high:
        low = 0.0
    elif 0.5 * low < high < 0:
        high = 0.0
    return "sequential", low, high
