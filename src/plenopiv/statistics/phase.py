"""Phase averages: statistics of the pairs that a signal puts into the same part of a period."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.errors import PlenoPIVError, printable
from plenopiv.statistics.series import ERROR_BARS, SeriesStatistics

if TYPE_CHECKING:
    import xarray as xr

HEADER = ["pair", "phase"]
PERIOD = 360.0
BINS = 8
LAGS = 4  # of the pairs of one bin, in their order


@dataclass(frozen=True)
class Phases:
    """The phase of pairs, by their number from 0, in the unit of ``period``; ``source`` names where they are from."""

    of_pair: Mapping[int, float]
    period: float
    source: str

    @classmethod
    def read(cls, path: str | Path, period: float = PERIOD) -> Phases:
        """From a CSV file with the header ``pair,phase``.

        Raises:
            PlenoPIVError: the file cannot be read; a line is no pair and phase, or its pair came before.
        """
        path = Path(path)
        if not (np.isfinite(period) and period > 0):
            raise PlenoPIVError(f"{path}: a period of {period:g} is none; give a positive number")
        try:
            rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines(), strict=True))
        except OSError as error:
            raise PlenoPIVError(f"{path}: cannot be read ({error.strerror or error})") from None
        except (UnicodeDecodeError, csv.Error):
            raise PlenoPIVError(f"{path}: is no CSV text; wanted lines of pair,phase") from None
        if not rows or [cell.strip().lower() for cell in rows[0]] != HEADER:
            raise PlenoPIVError(f"{path}: line 1: wanted the header {','.join(HEADER)}")
        found: dict[int, float] = {}
        for number, row in enumerate(rows[1:], 2):
            if not any(cell.strip() for cell in row):
                continue
            pair, phase = _pair_and_phase(row, f"{path}: line {number}")
            if pair in found:
                raise PlenoPIVError(f"{path}: line {number}: pair {pair} has a phase already")
            found[pair] = phase
        if not found:
            raise PlenoPIVError(f"{path}: names no pair; give lines of pair,phase, pairs counted from 0")
        return cls(found, float(period), str(path))

    def bins_of(self, bins: int) -> dict[int, int]:
        """The bin of each pair: bin k is centred on k/bins of the period.

        Raises:
            PlenoPIVError: no bins, or a phase of so many periods that its place in one is lost.
        """
        if bins < 1:
            raise PlenoPIVError(f"phase averages in {bins} bins are none; use 1 or more")
        for pair, phase in self.of_pair.items():
            if not np.spacing(abs(phase)) < self.period:  # the next number is another period already
                raise PlenoPIVError(
                    f"{self.source}: pair {pair}: a phase of {phase:g} is too large for its place in a period of "
                    f"{self.period:g} to be known; subtract whole periods"
                )
        return {pair: int(np.floor(phase / self.period * bins + 0.5)) % bins for pair, phase in self.of_pair.items()}

    def check(self, pairs: int) -> None:
        """Raise PlenoPIVError where a pair is named that a series of ``pairs`` has not."""
        if max(self.of_pair) >= pairs:
            raise PlenoPIVError(
                f"{self.source}: names pair {max(self.of_pair)}, the series has pairs 0 to {pairs - 1}; count from 0"
            )


def _pair_and_phase(row: list[str], where: str) -> tuple[int, float]:
    text = printable(",".join(row))[:60]
    try:
        pair, phase = int(row[0]), float(row[1])
    except (ValueError, IndexError):
        raise PlenoPIVError(f"{where}: {text!r} is no pair and phase; wanted for instance 0,12.5") from None
    if len(row) != 2 or pair < 0 or not np.isfinite(phase):
        raise PlenoPIVError(f"{where}: {text!r} is no pair from 0 on and finite phase; wanted for instance 0,12.5")
    return pair, phase


class PhaseStatistics:
    """``SeriesStatistics`` of each part of a period. Bin k is centred on k/``bins`` of the period, so that phases about
    0 are together. Pairs without a phase are left out.

    ``like``, ``lags``, ``replaced``, ``error_bars``: as for ``SeriesStatistics``; lags count the pairs of one bin.
    """

    def __init__(
        self,
        like: xr.Dataset,
        phases: Phases,
        bins: int = BINS,
        *,
        lags: int = LAGS,
        replaced: bool = False,
        error_bars: float = ERROR_BARS,
    ) -> None:
        self.phases, self.bins = phases, bins
        self._bin_of = phases.bins_of(bins)
        self._of_bin = [
            SeriesStatistics(like, lags=lags, replaced=replaced, error_bars=error_bars) for _ in range(bins)
        ]

    def add(self, field: xr.Dataset, pair: int) -> None:
        """The field of a pair, counted from 0; raises PlenoPIVError for another grid."""
        if pair in self._bin_of:
            self._of_bin[self._bin_of[pair]].add(field)

    def result(self) -> xr.Dataset:
        """Statistics on (phase, z, y, x): the variables of ``SeriesStatistics.result`` but for those of convergence,
        and ``pairs`` and ``pairs_left_out`` (phase,). ``phase`` is the middle of a bin."""
        import xarray as xr

        found = []
        for statistics in self._of_bin:
            one = statistics.result()
            found.append(one.drop_dims(["running", "component", "place"], errors="ignore"))
        together = xr.concat(found, "phase", combine_attrs="override")
        for name, text in (("pairs", "number of pairs"), ("pairs_left_out", "number of pairs without a vector")):
            counts = np.array([one.attrs[name] for one in found], np.int32)
            together[name] = "phase", counts, {"long_name": text, "units": "1"}
            together.attrs[name] = int(counts.sum())
        step = self.phases.period / self.bins
        together["phase"] = (
            "phase",
            step * np.arange(self.bins),
            {
                "units": "degree" if self.phases.period == PERIOD else "1",
                "long_name": "phase, middle of the bin",
                "comment": f"bins are {step:g} wide, the period is {self.phases.period:g}",
            },
        )
        together.attrs["title"] = "Phase averages of a series of velocity fields"
        together.attrs["correlated_beyond_lags_share"] = float(
            np.mean([one.attrs["correlated_beyond_lags_share"] for one in found])
        )
        return together
