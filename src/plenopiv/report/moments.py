"""Fields of a series for the page: some of its times, mean and RMS of all, read one field after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.io.netcdf import loaded, opened_velocity
from plenopiv.recording.recording import NUMBERED
from plenopiv.velocity import q_criterion, velocity_gradient, vorticity

if TYPE_CHECKING:
    import xarray

BLOCK_BYTES = 32 << 20  # read at once: each read of a file takes some milliseconds
PHASE = "phase"  # of a field that is of a phase, not of a pair
MEASURED = ("u", "v", "w", "u_std", "v_std", "w_std", "peak_ratio", "valid", "inside_body")
DIMS = ("time", "z", "y", "x")

Values = dict[str, NDArray]


@dataclass(frozen=True)
class Series:
    """Velocity fields on one grid: ``count`` of them; ``fields()`` gives one after the other, each on (z, y, x)."""

    count: int
    fields: Callable[[], Iterator[xarray.Dataset]]


@dataclass(frozen=True)
class Moment:
    """What the page can show at once: ``kind`` "time", "mean" or "rms"; ``values`` float32 on (z, y, x), thinned."""

    kind: str
    label: str
    values: Values = field(repr=False)


def series_in(dataset: xarray.Dataset) -> Series:
    """The times of a dataset that is in memory, dims (time, z, y, x)."""
    times = dataset.sizes["time"]
    return Series(times, lambda: (dataset.isel(time=k).transpose(*DIMS[1:], ...) for k in range(times)))


def series_of_file(path: Path) -> Series:
    """The times of a velocity file, read block by block.

    Raises:
        PlenoPIVError: it is no velocity field, or is damaged.
    """
    with opened_velocity(path) as dataset:
        count = dataset.sizes["time"]
    return Series(count, lambda: _read(path))


def _read(path: Path) -> Iterator[xarray.Dataset]:
    with opened_velocity(path) as dataset:
        fields = dataset[[name for name in (*MEASURED, PHASE) if name in dataset]].transpose(*DIMS, ...)
        count = dataset.sizes["time"]
        together = max(1, int(BLOCK_BYTES * count / max(fields.nbytes, 1)))
        for first in range(0, count, together):
            block = loaded(path, fields.isel(time=slice(first, first + together)))
            yield from (block.isel(time=k) for k in range(block.sizes["time"]))


def moments(series: Series, step: tuple[int, ...], most: int) -> list[Moment]:
    """At most ``most`` times, evenly chosen; of several times their mean and RMS fluctuation too.

    ``step``: every how many vectors along z, y, x one is taken. Derivatives, mean and RMS are of all vectors. As in
    statistics.nc a vector counts where it is valid; RMS has the random errors of vectors in it.
    """
    chosen = set(np.linspace(0, series.count - 1, min(max(most, 1), series.count)).round().astype(int).tolist())
    cut = tuple(slice(None, None, s) for s in step)
    found: list[Moment] = []
    running: _Running | None = None
    for k, one in enumerate(series.fields()):
        if running is None:
            running = _Running(one)
        if series.count > 1:
            running.add(one)
        if k in chosen:
            values = {name: one[name].values for name in MEASURED if name in one} | _turning(one)
            found.append(Moment("time", _named(one, k, series.count), _thinned(values, cut)))
    if running is not None and series.count > 1:
        mean, rms = running.mean(), running.rms()
        turning = _turning(running.like.assign({name: (DIMS[1:], mean[name]) for name in "uvw"}))
        counted = f"of {series.count} {what_of(running.like)}s"
        found.append(Moment("mean", f"mean {counted}", _thinned(mean | turning, cut)))
        found.append(Moment("rms", f"RMS fluctuation {counted}", _thinned(rms, cut)))
    return found


def what_of(field: xarray.Dataset) -> str:
    """What a velocity field is of: a "pair", or a "phase" of an ensemble."""
    return "phase" if PHASE in field else "pair"


def named(field: xarray.Dataset, number: int, count: int | None = None) -> str:
    """What a field is of in words, from its ``number`` (from 0), of a ``count`` where that is told."""
    what = what_of(field)
    if number == 0:
        return f"the first {what}" if count is None else f"the first of {count:,} {what}s"
    return f"{what} {number + 1:,}" + ("" if count is None else f" of {count:,}")


def are_numbered(field: xarray.Dataset) -> bool:
    """Whether its times, or those that they are means of, only number the pairs of a double-frame camera."""
    return "time" in field.coords and NUMBERED in str(field["time"].attrs.get("long_name", ""))


def _named(one: xarray.Dataset, number: int, count: int) -> str:
    known = "time" in one.coords and not are_numbered(one)
    of_time = f", t = {float(one['time']):.6g} s" if known else ""
    if what_of(one) == "pair":
        return f"pair {number + 1} of {count}{of_time}"
    unit = one[PHASE].attrs.get("units", "1")
    return f"phase {float(one[PHASE]):.6g}{'' if unit == '1' else f' {unit}'}, {number + 1} of {count}"


class _Running:
    """Mean and mean square of the fluctuations of u, v, w, one field after the other (Welford)."""

    def __init__(self, like: xarray.Dataset) -> None:
        self.like = like[[name for name in (*"uvw", PHASE) if name in like]].transpose(*DIMS[1:])
        shape = self.like["u"].shape
        self.count = np.zeros(shape)
        self._mean, self._squares = np.zeros((3, *shape)), np.zeros((3, *shape))

    def add(self, one: xarray.Dataset) -> None:
        values = np.stack([one[name].values for name in "uvw"]).astype(float)
        counted = np.isfinite(values).all(0) & (one["valid"].values == 1)
        self.count += counted
        apart = np.where(counted, values - self._mean, 0.0)
        self._mean += apart / np.maximum(self.count, 1)
        self._squares += apart * np.where(counted, values - self._mean, 0.0)

    def mean(self) -> Values:
        found = np.where(self.count > 0, self._mean, np.nan)
        return {**dict(zip("uvw", found, strict=True)), "valid": (self.count > 0).astype(np.int8)}

    def rms(self) -> Values:
        """Over n - 1; NaN where fewer than two count."""
        with np.errstate(invalid="ignore", divide="ignore"):
            found = np.where(self.count > 1, np.sqrt(self._squares / (self.count - 1)), np.nan)
        return {**dict(zip("uvw", found, strict=True)), "valid": (self.count > 1).astype(np.int8)}


def _turning(one: xarray.Dataset) -> Values:
    """Derivatives on the field's grid, in 1/s and 1/s^2; none of a field without extent along some axis."""
    if min(one.sizes[axis] for axis in "xyz") < 2:
        return {}
    gradient = velocity_gradient(one[["u", "v", "w"]])
    return {
        "q": q_criterion(gradient),
        "vorticity": np.sqrt((vorticity(gradient) ** 2).sum(0)),
        "divergence": np.einsum("ii...->...", gradient),
    }


def _thinned(values: Values, cut: tuple[slice, ...]) -> Values:
    return {
        name: full[cut].astype(full.dtype if full.dtype.kind in "iub" else np.float32) for name, full in values.items()
    }
