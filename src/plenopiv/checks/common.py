"""Whether the two frames of a pair have particles in common, asked of the field that was measured between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.checks.findings import Finding
from plenopiv.velocity import replaced_share

if TYPE_CHECKING:
    import xarray

NAME = "unrelated"
MOST_REPLACED = 0.5  # of the vectors: of frames that have nothing in common 0.85 to 0.95, 0.48 where there are few
MANY_REPLACED = 0.25
# Median ratio of the highest peak to the next. Frames that have nothing in common have 1.2 to 1.7, at .1 particle per
# microlens up to 2.5; those that have something 6 and more, 2.2 to 3 where windows hold five particles.
CLEAR_PEAK, CHANCE_PEAK = 2.0, 1.5
ADVICE = (
    "are these two frames of one pair, in one orientation? If so: a smaller dt, larger first windows, more light or "
    "particles; plenopiv check tells more"
)


def finding(velocity: xarray.Dataset, names: Sequence[str]) -> Finding | None:
    """A finding where most vectors between the frames ``names`` had to be replaced."""
    share, ratio = replaced_share(velocity), float(np.nanmedian(velocity["peak_ratio"].values))
    if share < MANY_REPLACED or (share < MOST_REPLACED and ratio > CLEAR_PEAK):
        return None
    nothing = ratio < (CLEAR_PEAK if share > MOST_REPLACED else CHANCE_PEAK)
    has = "have nothing in common" if nothing else "have little in common"
    words = f"{names[0]} and {names[1]} {has}: {100 * share:.0f} % of the vectors had to be replaced"
    return Finding(NAME, "unusable" if nothing else "warning", words, 100 * share, "%", ADVICE)
