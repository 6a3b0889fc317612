"""Two results side by side, from their files: one time after the other, so that a series may have any length."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.comparison import Comparison, Differences, Field, Measures, Overlap, Row, Setting, Shown
from plenopiv.comparison.differences import Z_EDGES
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import text
from plenopiv.io.beside import unfinished
from plenopiv.io.fields import units_of, variables_of_time
from plenopiv.io.netcdf import DIMS, loaded, opened_velocity
from plenopiv.report.document import flat
from plenopiv.report.moments import are_numbered

if TYPE_CHECKING:
    import xarray

VELOCITY, EXPERIMENT = "velocity.nc", "experiment.toml"
SAME_TIME = 1e-3  # of dt: times nearer than this are the same
SAME_PHASE = 1e-4  # of the phases that there are, lowest to highest
KEYWORDS = {"none", "minimum"}  # of [recording], in place of a file's name
OF_RECORDING = ("white", "dark", "frames", "pairs", "background", "mask")
FILES = {"volume.body", "calibration.planes", *(f"recording.{key}" for key in OF_RECORDING)}
LEFT_OUT = "output."  # where results are is no setting of theirs

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Result:
    """A velocity file, and the experiment file beside it, None where there is none."""

    velocity: Path
    tables: dict[str, Any] | None

    @classmethod
    def of(cls, path: str | Path) -> Result:
        """Of a results folder or a velocity file.

        Raises:
            PlenoPIVError: a folder without velocity.nc; an experiment file that cannot be read.
        """
        path = Path(path)
        try:
            velocity = path / VELOCITY if path.is_dir() else path
            if path.is_dir() and not velocity.is_file():
                remedy = unfinished(path) or "plenopiv run writes it into its results folder"
                raise PlenoPIVError(f"{path}: holds no {VELOCITY}; {remedy}")
            experiment = velocity.parent / EXPERIMENT
            tables = text.tables(experiment.read_bytes(), experiment) if experiment.is_file() else None
        except (OSError, ValueError) as error:
            raise PlenoPIVError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        return cls(velocity, tables)

    def voxel_mm(self) -> tuple[float, float, float] | None:
        """Sides of a voxel; None where they are not known."""
        volume = (self.tables or {}).get("volume")
        sides = volume.get("voxel_mm") if isinstance(volume, dict) else None
        if not isinstance(sides, list) or len(sides) != 3:
            return None
        if not all(isinstance(side, float | int) and 0 < side < np.inf for side in sides):
            return None
        x, y, z = map(float, sides)
        return x, y, z

    def settings(self) -> dict[str, Any]:
        """Keys with dots, but for those of output; files by their absolute paths."""
        keys = {key: value for key, value in flat(self.tables or {}).items() if not key.startswith(LEFT_OUT)}
        folder = self.velocity.parent.resolve()
        return {key: _absolute(value, folder) if key in FILES else value for key, value in keys.items()}


def compare(a: str | Path, b: str | Path, progress: Progress | None = None) -> Comparison:
    """Two results side by side, each a results folder or a velocity file: differences B - A of the vectors that both
    measured, in m/s, in A's voxels, and in standard deviations sqrt(std_a^2 + std_b^2).

    Times are matched by their coordinate, fields of phases by their phase. Where B's vectors lie elsewhere than A's, B
    is interpolated linearly at A's within the region that both cover. One time is in memory at a time.

    Raises:
        PlenoPIVError: a result cannot be read; one is of the camera's frame, the other of the laboratory's; no time or
            no region is in both; nothing was measured in both.
    """
    report = progress or (lambda stage, done, total: None)
    one, other = Result.of(a), Result.of(b)
    with ExitStack() as stack:
        first, second = (stack.enter_context(opened_velocity(result.velocity)) for result in (one, other))
        _same_frame(one.velocity, first, other.velocity, second)
        pairs = _same_times(one.velocity, first, other.velocity, second)
        overlap = _overlap(one.velocity, first, other.velocity, second)
        differences, shown = Differences(first["z"].values[overlap.z.inside].astype(float)), None
        for done, (k, n) in enumerate(pairs):
            report("comparison", done, len(pairs))
            before = overlap.of_a(Field.of(loaded(one.velocity, _needed(first).isel(time=k))))
            after = overlap.of_b(Field.of(loaded(other.velocity, _needed(second).isel(time=n))))
            if differences.add(before, after) and shown is None:
                axes = [first[axis].values.astype(float)[getattr(overlap, axis).inside] for axis in "xyz"]
                time_s = float(first["time"].values[k])
                shown = Shown(time_s, _when(first, k), (axes[0], axes[1], axes[2]), before, after)
        report("comparison", len(pairs), len(pairs))
        if shown is None:
            raise PlenoPIVError(f"{one.velocity}, {other.velocity}: no vector was measured in both")
        times = len(pairs), first.sizes["time"] - len(pairs), second.sizes["time"] - len(pairs)
        vectors = len(pairs) * prod(first.sizes[axis] for axis in "xyz")
        rows = _rows(differences, one, first)
    return Comparison(
        one.velocity,
        other.velocity,
        times,
        overlap.interpolates,
        vectors,
        differences.vectors,
        differences.both,
        (differences.replaced_a, differences.replaced_b),
        rows,
        _settings(one, other),
        differences.histograms(),
        Z_EDGES,
        shown,
        "laboratory" in (field.attrs.get("frame") for field in (first, second)),
    )


def _when(dataset: xarray.Dataset, number: int) -> str:
    """Which time of a field that is, in words."""
    if "phase" in variables_of_time(dataset):
        return f"phase {float(dataset['phase'].values[number]):.6g} {units_of(dataset['phase'])}".removesuffix(" 1")
    if "pairs" in variables_of_time(dataset):
        return "the mean over all pairs"
    if are_numbered(dataset):
        return f"pair {number + 1}"
    return f"time {float(dataset['time'].values[number]):.6g} s"


def _same_frame(a: Path, first: xarray.Dataset, b: Path, second: xarray.Dataset) -> None:
    """Refuse fields that say of themselves that their x, y, z are of different frames.

    Raises:
        PlenoPIVError: they do.
    """
    frames = [field.attrs.get("frame") for field in (first, second)]
    if None not in frames and frames[0] != frames[1]:
        raise PlenoPIVError(
            f"{a} is in the frame of the {frames[0]}, {b} in that of the {frames[1]}: x, y, z are not the same in both"
        )


def _needed(dataset: xarray.Dataset) -> xarray.Dataset:
    """The variables that are compared."""
    names = ("u", "v", "w", "u_std", "v_std", "w_std", "valid", "inside_body")
    usable = [n for n in names if n in dataset and dataset[n].dims == DIMS and dataset[n].dtype.kind in "biuf"]
    return dataset[usable]


def _dt_s(dataset: xarray.Dataset) -> float | None:
    """Time between the frames of a pair; None where the file does not say."""
    stated = dataset.attrs.get("dt_s")
    if not isinstance(stated, float | int | np.floating | np.integer) or not 0 < stated < np.inf:
        return None
    return float(stated)


def _same_times(a: Path, first: xarray.Dataset, b: Path, second: xarray.Dataset) -> list[tuple[int, int]]:
    """Numbers of the times that are in both, each once; of the phases where both have them in one unit: their times are
    means over pairs, and may coincide. Times that only number the pairs of a double-frame camera are compared in units
    of their own dt_s.

    Raises:
        PlenoPIVError: there are none.
    """
    both = all("phase" in variables_of_time(dataset) for dataset in (first, second))
    units = [units_of(dataset["phase"]) for dataset in (first, second)] if both else []
    name, unit = ("phase", units[0]) if len(set(units)) == 1 else ("time", "s")
    ours, theirs = (dataset[name].values.astype(float) for dataset in (first, second))
    if name == "phase":
        near = SAME_PHASE * float(np.ptp([*ours, *theirs]))
    else:
        of_a, of_b = _dt_s(first), _dt_s(second)
        near = SAME_TIME * (of_a or of_b or 1e-6)
        if of_a and of_b and are_numbered(first) and are_numbered(second):
            theirs = theirs * (of_a / of_b)
    order = np.argsort(theirs, kind="stable")
    place = np.searchsorted(theirs[order], ours - near)
    pairs, taken = [], set[int]()
    for k, (time, at) in enumerate(zip(ours, place, strict=True)):
        found = next((n for n in range(at, order.size) if n not in taken or theirs[order[n]] > time + near), order.size)
        if found < order.size and theirs[order[found]] <= time + near:
            taken.add(found)
            pairs.append((k, int(order[found])))
    if not pairs:
        spans = [f"{t.min():g} to {t.max():g} {unit}" for t in (ours, theirs)]
        raise PlenoPIVError(f"{a}, {b}: no {name} is in both: {spans[0]} and {spans[1]}; are they of one recording?")
    return pairs


def _overlap(a: Path, first: xarray.Dataset, b: Path, second: xarray.Dataset) -> Overlap:
    """Where both have vectors.

    Raises:
        PlenoPIVError: nowhere.
    """
    overlap = Overlap.of(*({axis: dataset[axis].values for axis in "xyz"} for dataset in (first, second)))
    for axis in "xyz":
        if not getattr(overlap, axis).inside.size:
            spans = [f"{d[axis].values.min():.4g} to {d[axis].values.max():.4g} mm" for d in (first, second)]
            raise PlenoPIVError(
                f"{a}, {b}: no vector of the first lies within the second: {axis} {' and '.join(spans)}"
            )
    return overlap


def _rows(differences: Differences, one: Result, first: xarray.Dataset) -> tuple[Row, ...]:
    voxel_mm, dt_s = one.voxel_mm(), _dt_s(first)
    rows = []
    for depth, measures in differences.measures().items():
        for n, (component, m_s) in enumerate(zip("uvw", measures, strict=True)):
            voxels: Measures | None = None
            if voxel_mm is not None and dt_s is not None:
                voxels = m_s.scaled(1e3 * dt_s / voxel_mm[n])
            rows.append(Row(depth, component, m_s, voxels))
    return tuple(rows)


def _settings(one: Result, other: Result) -> tuple[Setting, ...] | None:
    if one.tables is None or other.tables is None:
        return None
    ours, theirs = one.settings(), other.settings()
    keys = [*ours, *(key for key in theirs if key not in ours)]
    return tuple(Setting(k, ours.get(k), theirs.get(k)) for k in keys if ours.get(k) != theirs.get(k))


def _absolute(value: Any, folder: Path) -> Any:
    """Names of files, or nested lists of them, from a folder on; numbers and words that are no files as they are."""
    if isinstance(value, str):
        return value if value in KEYWORDS else os.path.normpath(folder / value)
    if isinstance(value, Mapping):
        return {key: _absolute(item, folder) for key, item in value.items()}
    return [_absolute(item, folder) for item in value] if isinstance(value, Sequence) else value
