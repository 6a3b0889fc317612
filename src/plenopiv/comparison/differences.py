"""Differences of many fields, one time after the other: what is held does not grow with their number."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from plenopiv.comparison.overlap import Field

DROPPED_BITS = 14  # of a float32: sizes are counted in bins of 2^-9 of a size, for the median
BINS = 1 << (31 - DROPPED_BITS)
Z_EDGES = np.linspace(-5.0, 5.0, 101)  # of the histogram in standard deviations; what is beyond lies in the outer bins


@dataclass(frozen=True)
class Measures:
    """Of differences, in their unit: their number, mean, RMS (about 0), median and largest size; ``beyond`` one and
    two standard deviations of the difference, as shares, NaN where none are stated.

    The median is that of the sizes, right to 0.1 %.
    """

    count: int
    mean: float
    rms: float
    median: float
    largest: float
    beyond: tuple[float, float]

    def scaled(self, factor: float) -> Measures:
        """The same in another unit."""
        mean, rms, median, largest = (factor * value for value in (self.mean, self.rms, self.median, self.largest))
        return Measures(self.count, mean, rms, median, largest, self.beyond)


@dataclass
class _Sums:
    """Sums over the differences of one component in one part of the depth."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0
    with_std: int = 0
    beyond: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, np.int64))
    sizes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(BINS, np.int64))
    z: NDArray[np.int64] = field(default_factory=lambda: np.zeros(Z_EDGES.size - 1, np.int64))

    def add(self, difference: NDArray[np.float64], std: NDArray[np.float64]) -> None:
        if not difference.size:
            return
        size = np.abs(difference)
        self.count += size.size
        self.total += float(difference.sum())
        self.squares += float(np.square(size).sum())
        self.largest = max(self.largest, float(size.max()))
        bins = np.ascontiguousarray(size, np.float32).view(np.uint32) >> DROPPED_BITS
        np.add(self.sizes, np.bincount(bins, minlength=BINS), out=self.sizes)
        stated = np.isfinite(std) & (std > 0)
        z = difference[stated] / std[stated]
        self.with_std += z.size
        self.beyond += [int((np.abs(z) > limit).sum()) for limit in (1, 2)]
        inside = np.clip(z, Z_EDGES[0], np.nextafter(Z_EDGES[-1], 0))
        self.z += np.histogram(inside, Z_EDGES)[0]

    def measures(self) -> Measures:
        if not self.count:
            return Measures(0, np.nan, np.nan, np.nan, np.nan, (np.nan, np.nan))
        beyond = self.beyond / self.with_std if self.with_std else np.full(2, np.nan)
        mean, rms = self.total / self.count, float(np.sqrt(self.squares / self.count))
        return Measures(self.count, mean, rms, self._median(), self.largest, (float(beyond[0]), float(beyond[1])))

    def _median(self) -> float:
        upto = np.cumsum(self.sizes)
        middle = [np.searchsorted(upto, rank, side="right") for rank in ((self.count - 1) // 2, self.count // 2)]
        edges = (np.array([middle, np.add(middle, 1)], np.uint32) << DROPPED_BITS).view(np.float32).astype(float)
        return min(float(edges.mean()), self.largest) if middle[1] else 0.0


def _together(parts: list[_Sums]) -> _Sums:
    return _Sums(
        sum(p.count for p in parts),
        sum(p.total for p in parts),
        sum(p.squares for p in parts),
        max(p.largest for p in parts),
        sum(p.with_std for p in parts),
        np.sum([p.beyond for p in parts], 0),
        np.sum([p.sizes for p in parts], 0),
        np.sum([p.z for p in parts], 0),
    )


class Differences:
    """Differences B - A of vectors that both measured, by component and thirds of the depth.

    ``z_mm`` (nz,): depth of the vectors, rising. Thirds are of equal depth; one in which no plane lies is left out.
    """

    def __init__(self, z_mm: NDArray[np.float64]) -> None:
        low, high = float(z_mm[0]), float(z_mm[-1])
        third = np.minimum(3 * (z_mm - low) / (high - low or 1.0), 2.999).astype(int)
        self._planes = [np.flatnonzero(third == n) for n in range(3) if (third == n).any()]
        self.depths_mm = [(float(z_mm[planes[0]]), float(z_mm[planes[-1]])) for planes in self._planes]
        self._sums = [[_Sums() for _ in self._planes] for _ in "uvw"]
        self.both = self.replaced_a = self.replaced_b = self.vectors = 0

    def add(self, a: Field, b: Field) -> int:
        """Both fields of one time, at the same vectors; how many both measured."""
        both = a.measured & b.measured
        self.vectors += both.size
        self.both += int(both.sum())
        self.replaced_a += int(a.replaced.sum())
        self.replaced_b += int(b.replaced.sum())
        for component, sums in enumerate(self._sums):
            difference = b.velocity[component] - a.velocity[component]
            std = np.hypot(a.std[component], b.std[component])
            for planes, each in zip(self._planes, sums, strict=True):
                chosen = both[planes]
                each.add(difference[planes][chosen], std[planes][chosen])
        return int(both.sum())

    def measures(self) -> dict[tuple[float, float] | None, list[Measures]]:
        """Of u, v, w in m/s: at all depths (key None), and in each third, by its first and last plane in mm."""
        found: dict[tuple[float, float] | None, list[Measures]] = {None: [_together(s).measures() for s in self._sums]}
        if len(self._planes) > 1:
            for n, depth in enumerate(self.depths_mm):
                found[depth] = [sums[n].measures() for sums in self._sums]
        return found

    def histograms(self) -> NDArray[np.int64]:
        """Numbers of differences in standard deviations, (3, bins) between ``Z_EDGES``."""
        return np.stack([_together(sums).z for sums in self._sums])
