"""The facts of a run at the top of its report: what was measured, how, and how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.displacement.resolution import effective_window
from plenopiv.experiment import Experiment
from plenopiv.report.document import plain
from plenopiv.report.moments import named, what_of
from plenopiv.velocity import replaced_share, vectors_inside_body

if TYPE_CHECKING:
    import xarray

ROWS = (("x", "u"), ("y", "v"), ("z", "w"))
HEAD = ("along", "displacement, voxels", "velocity, m/s", "median error bar, m/s")


def facts(
    title: str,
    experiment: Experiment,
    dataset: xarray.Dataset,
    summary: Mapping[str, Any],
    pairs: int,
    number: int,
    date: str,
) -> str:
    """The head of the page. ``dataset``: the velocity field that it shows, that of ``number`` (from 0) of ``pairs`` or
    phases; ``date``: when it was evaluated, "" where that is not said."""
    told = [f"{experiment.folder.resolve().name}/{experiment.path.name}"]
    told += [f"evaluated {date}"] if date else []
    told += [f"PlenoPIV {summary['plenopiv']}"] if "plenopiv" in summary else []
    run = f'<p class="run">{plain(" · ".join(told))}</p>'
    numbers = _numbers(experiment, dataset, summary, pairs)
    items = "".join(f"<div><dt>{plain(label)}</dt><dd>{plain(value)}</dd></div>" for value, label in numbers)
    return f"<header><h1>{plain(title)}</h1>{run}<dl>{items}</dl>{_ranges(experiment, dataset, pairs, number)}</header>"


def _numbers(
    experiment: Experiment, dataset: xarray.Dataset, summary: Mapping[str, Any], pairs: int
) -> list[tuple[str, str]]:
    """(value, what it is)."""
    sizes, timings = dataset.sizes, summary.get("timings_s", {})
    valid = 1 - summary.get("replaced_share", replaced_share(dataset))
    solid = summary.get("vectors_inside_body", vectors_inside_body(dataset))
    axes = ("x", "y", "z")
    spacing = [float(np.diff(dataset[axis].values[:2])[0]) if sizes[axis] > 1 else None for axis in axes]
    voxel_mm = experiment.volume.voxel_mm
    windows = experiment.correlation.windows[-1]
    resolved = effective_window(experiment.correlation.settings())
    window_mm = [n * d for n, d in zip(windows, voxel_mm, strict=True)]
    recording = experiment.recording_table
    numbers = [
        (f"{summary.get('vectors', dataset['valid'].size):,}", "vectors"),
        *_counts(dataset, summary, pairs),
        (f"{100 * valid:.1f} %", "measured, not replaced" + (", outside the body" if solid else "")),
        (_times(windows, "d") + " voxels", f"last window: {_times(window_mm, '.3g')} mm"),
        (_times(resolved, ".0f") + " voxels", "box whose mean resolves the same"),
        (_times(spacing, ".3g") + " mm", "vector spacing x, y, z"),
        (f"{experiment.grid().size / 1e6:.1f} million", "voxels"),
    ]
    told = summary.get("not_in_images", {})
    dt_s, orientation = told.get("dt_s", recording.dt_s), told.get("orientation", recording.orientation)
    numbers.append((f"{dt_s:g} s, {orientation}", "dt and orientation: no image tells whether they are right"))
    if told:
        moved = _times(told["largest_displacement_voxels"], ".2g")
        numbers += [
            (f"{moved} voxels", "largest displacement x, y, z"),
            (f"{told['largest_velocity_m_s']:.3g} m/s", "largest velocity"),
        ]
    if timings:
        numbers.append((_duration(sum(timings.values())), "computing"))
    return numbers


def _counts(dataset: xarray.Dataset, summary: Mapping[str, Any], fields: int) -> list[tuple[str, str]]:
    """Of pairs, and of phases where there are some; of an ensemble all pairs that are in it."""
    pairs = sum(summary["ensemble"]["pairs"]) if "ensemble" in summary else fields
    counts = [(pairs, "pair"), (fields, "phase")] if what_of(dataset) == "phase" else [(pairs, "pair")]
    return [(f"{count:,}", f"{name}{'s'[: count != 1]}") for count, name in counts]


def _ranges(experiment: Experiment, dataset: xarray.Dataset, pairs: int, number: int) -> str:
    """Along each axis the displacements and velocities of the vectors that are shown, and their median error bar."""
    field = dataset.isel(time=0)
    dt_s = experiment.recording_table.dt_s
    rows = []
    for (axis, name), voxel in zip(ROWS, experiment.volume.voxel_mm, strict=True):
        values = field[name].values
        values = values[np.isfinite(values)]
        std = field[f"{name}_std"].values if f"{name}_std" in field else np.empty(0)
        std = std[np.isfinite(std)]
        rows.append(
            (axis, _range(values * 1e3 * dt_s / voxel), _range(values), f"{np.median(std):.2g}" if std.size else "–")
        )
    head = "".join(f"<th>{plain(text)}</th>" for text in HEAD)
    body = "".join("<tr>" + "".join(f"<td>{plain(text)}</td>" for text in row) + "</tr>" for row in rows)
    which = f", of {named(dataset, number, pairs)}" if pairs > 1 else ""
    counted = " Pairs are counted from 1 here, from 0 in summary.json and names of files." if number else ""
    words = f"Lowest to highest of all vectors{which}; error bar: one standard deviation.{counted}"
    return (
        f'<div class="wide"><table class="facts"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        f'<p class="run">{plain(words)}</p>'
    )


def _range(values: np.ndarray) -> str:
    return f"{values.min():.3g} to {values.max():.3g}".replace("-", "−") if values.size else "–"


def _times(values: Sequence[float | None], form: str) -> str:
    return " × ".join("–" if value is None else format(value, form) for value in values)


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"
