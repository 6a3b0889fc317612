"""How mean and RMS at a few places settle with the number of pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.statistics.correlated import Spacing
from plenopiv.statistics.moments import FEWEST, Moments

if TYPE_CHECKING:
    import xarray as xr

RECORDS = 128  # kept at most: of a longer series every second, fourth, ... pair
PLACES = ((0.5, 0.5, 0.5), (0.25, 0.5, 0.5), (0.75, 0.5, 0.5), (0.5, 0.25, 0.25), (0.5, 0.75, 0.75))  # z, y, x


class Convergence:
    """Running mean and moments at PLACES of the volume, moved to the nearest vector that counts in the first field."""

    def __init__(self, coordinates: Mapping[str, xr.DataArray]) -> None:
        self._places_mm = [coordinates[axis].values.astype(float) for axis in ("z", "y", "x")]
        self.at: tuple[NDArray[np.int64], ...] | None = None  # z, y, x indices
        self._every = 1
        self._kept: list[tuple[int, NDArray[np.float64]]] = []
        self._newest: tuple[int, NDArray[np.float64]] | None = None

    def add(self, number: int, moments: Moments) -> None:
        """The moments after ``number`` pairs."""
        if self.at is None:
            self.at = _nearest(np.argwhere(moments.count > 0), moments.count.shape)
        i = self.at
        now = np.stack(
            [np.broadcast_to(moments.count[i], (3, len(i[0]))).astype(float), moments.mean.transpose(1, 2, 3, 0)[i].T]
            + [np.stack([moments.central((c, p))[i] for c in range(3)]) for p in (2, 4)]
        )
        self._newest = number, now  # (count, mean, second, fourth moment; component; place)
        if number % self._every == 0:
            self._kept.append(self._newest)
            if len(self._kept) >= RECORDS:
                self._every *= 2
                self._kept = [(k, values) for k, values in self._kept if k % self._every == 0]

    def variables(self, spacing: Spacing) -> dict[str, tuple[tuple[str, ...], NDArray]]:
        """Of the dataset: place_x, place_y, place_z (place,) in mm; running_mean, running_rms and their ``_std``
        (running, component, place) in m/s, after running_pairs (running,) pairs. None before the first field.

        Standard deviations are those of ``SeriesStatistics``, with the correlation in time of all pairs.
        """
        if self.at is None or self._newest is None:
            return {}
        kept = self._kept if self._kept and self._kept[-1][0] == self._newest[0] else [*self._kept, self._newest]
        n, mean, square, fourth = np.stack([values for _, values in kept], 1)
        of_mean = np.stack([spacing(c)[self.at] for c in range(3)])
        of_square = np.stack([spacing(c, c)[self.at] for c in range(3)])
        variance = np.where(n > 1, square * n / (n - 1), np.nan)
        scatter = np.where(n > 1, square, np.nan)  # of one vector it is 0 and tells nothing
        left = np.maximum(n - 2 * of_mean - of_square, 0.25 * n)
        spread = np.sqrt((fourth - square**2).clip(0) * of_square / left)
        rms = np.sqrt(variance)
        dims = ("running", "component", "place")
        found: dict[str, tuple[tuple[str, ...], NDArray]] = {
            "running_pairs": (("running",), np.array([k for k, _ in kept], np.int32)),
            "running_mean": (dims, mean),
            "running_mean_std": (dims, np.sqrt(scatter * np.minimum(of_mean, n) / np.maximum(n - of_mean, 0.25 * n))),
            "running_rms": (dims, rms),
            "running_rms_std": (dims, np.where(n >= FEWEST, spread / (2 * rms), np.nan)),
        }
        for axis, values, index in zip("zyx", self._places_mm, self.at, strict=True):
            found[f"place_{axis}"] = ("place",), values[index]
        return found


def _nearest(known: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[NDArray[np.int64], ...]:
    """Indices of the known vectors nearest to PLACES, each once."""
    wanted = np.array(PLACES) * (np.array(shape) - 1)
    scale = np.maximum(np.array(shape) - 1, 1)
    found = {tuple(known[np.argmin((((known - place) / scale) ** 2).sum(1))].tolist()): None for place in wanted}
    return tuple(np.array(list(found)).T)
