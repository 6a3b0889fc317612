"""What a comparison of two results finds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.comparison.differences import Measures
from plenopiv.comparison.overlap import Field


@dataclass(frozen=True)
class Row:
    """Differences B - A of one component ("u", "v" or "w"), in m/s, and in A's voxels per frame where these are known;
    ``depth_mm``: first and last plane, None for all depths."""

    depth_mm: tuple[float, float] | None
    component: str
    m_s: Measures
    voxels: Measures | None


@dataclass(frozen=True)
class Setting:
    """A key of the experiment file that differs, with both values; None where a file does not have it."""

    key: str
    a: Any
    b: Any


@dataclass(frozen=True)
class Shown:
    """Both fields at the first time at which both measured: A's vectors where B has some, and B read there.
    ``when``: which time that is; ``axes_mm``: x, y, z."""

    time_s: float
    when: str
    axes_mm: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
    a: Field
    b: Field


@dataclass(frozen=True)
class Comparison:
    """Two results side by side.

    ``a``, ``b``: their velocity files. ``times``: how many are in both, in A alone, in B alone. ``interpolated``:
    whether B was read linearly between its vectors. Of A's ``vectors`` at these times, ``within`` lie within B's,
    ``both`` of these were measured in both, ``replaced`` in A and in B (where one that B is read from was).
    ``settings``: keys that differ, None where one result has no experiment file. ``histograms``: numbers of
    differences (3, bins) of u, v, w between ``edges``, in standard deviations of the difference. ``laboratory``: whose
    x, y, z they are, else the camera's.
    """

    a: Path
    b: Path
    times: tuple[int, int, int]
    interpolated: bool
    vectors: int
    within: int
    both: int
    replaced: tuple[int, int]
    rows: tuple[Row, ...]
    settings: tuple[Setting, ...] | None
    histograms: NDArray[np.int64]
    edges: NDArray[np.float64]
    shown: Shown | None
    laboratory: bool = False

    def __repr__(self) -> str:
        return f"<Comparison of {self.a} and {self.b}: {self.both} of {self.vectors} vectors measured in both>"

    def row(self, component: str, depth_mm: tuple[float, float] | None = None) -> Row:
        """Of one component, at all depths or in one third.

        Raises:
            KeyError: there is none.
        """
        found = [row for row in self.rows if row.component == component and row.depth_mm == depth_mm]
        if not found:
            raise KeyError((component, depth_mm))
        return found[0]
