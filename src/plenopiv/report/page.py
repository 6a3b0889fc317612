"""The page: key numbers, warnings, figures, accuracy, settings, timings, in one HTML file without outside resources."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from plenopiv.experiment import Experiment
from plenopiv.report.figures import histogram_figure, png, raw_figure, velocity_figure, volume_figure
from plenopiv.report.style import STYLE
from plenopiv.report.views import Projections, RawCrop

if TYPE_CHECKING:
    import xarray


def write_report(
    path: str | Path,
    *,
    title: str,
    experiment: Experiment,
    summary: Mapping[str, Any],
    dataset: xarray.Dataset,
    crops: Sequence[RawCrop] = (),
    views: Projections | None = None,
    accuracy: Mapping[str, Any] | None = None,
) -> None:
    """Write the report of a run.

    ``summary`` is what goes to summary.json: its ``warnings`` (a list of lines) and ``timings_s`` (stage -> seconds)
    have sections of their own, all else is tabled by dotted key. ``dataset`` is the velocity field, dims
    (time, z, y, x); of several times the first is drawn. ``accuracy`` is for recordings whose truth is known: measure
    -> number or text.
    """
    warnings, timings = list(summary.get("warnings", [])), dict(summary.get("timings_s", {}))
    others = {key: value for key, value in summary.items() if key not in ("warnings", "timings_s")}
    dt_s, voxel_mm = experiment.recording_table.dt_s, experiment.volume.voxel_mm
    times = dataset.sizes["time"]
    first = f"The first of {times} times. " if times > 1 else ""
    body = [
        f"<header><h1>{escape(title)}</h1>{_key_numbers(experiment, dataset, timings)}</header>",
        _warnings(warnings),
        _section(
            "Velocity",
            f"{first}Slices through the middle of the volume. Colour: velocity through the slice; arrows: velocity in "
            "the slice, all to one scale; crosses: vectors that were replaced. +z points toward the camera.",
            velocity_figure(dataset),
        ),
    ]
    if accuracy:
        body.append(_section("Accuracy", "Against the known truth of this recording.", _table(accuracy, "measure")))
    body.append(
        _section(
            "Displacements",
            "Before any replacement. Peak locking would crowd the middle figure at 0; an even spread is flat, if "
            "displacements cover several voxels.",
            histogram_figure(dataset, voxel_mm, dt_s),
        )
    )
    if views is not None:
        body.append(
            _section(
                "Reconstruction",
                "Maximum projections of the first frame's volume. Particles should be small and alike; streaks along z "
                "are ghosts, or particles near the focal plane, where depth cannot be told.",
                volume_figure(views),
            )
        )
    if crops:
        body.append(
            _section(
                "Microlenses",
                "Raw pixels with the lattice as found. Each circle should hold one micro-image, at the sensor's corner "
                "as well as in the middle.",
                raw_figure(crops),
            )
        )
    body += [
        _section("Numbers", "The content of summary.json.", _table(_flat(others), "key")),
        _section("Timings", "", _timings(timings)) if timings else "",
        _section("Settings", "The experiment file, every default written out.", _listing(experiment.dump_toml())),
    ]
    Path(path).write_text(PAGE.format(title=escape(title), style=STYLE, body="\n".join(body)), encoding="utf-8")


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
<footer>Lengths in mm, velocities in m/s, z = 0 the focal plane. Written by PlenoPIV.</footer>
</body>
</html>
"""


def _key_numbers(experiment: Experiment, dataset: xarray.Dataset, timings: Mapping[str, float]) -> str:
    sizes = dataset.sizes
    valid = float(np.mean(dataset["valid"].values == 1))
    spacing = [
        float(np.diff(dataset[axis].values[:2])[0]) if sizes[axis] > 1 else float("nan") for axis in ("x", "y", "z")
    ]
    windows = experiment.correlation.windows[-1]
    numbers = [
        (f"{prod(sizes[axis] for axis in ('time', 'z', 'y', 'x')):,}", "vectors"),
        (f"{100 * valid:.1f} %", "measured, not replaced"),
        (" × ".join(f"{d:.2f}" if np.isfinite(d) else "–" for d in spacing) + " mm", "vector spacing x, y, z"),
        (" × ".join(map(str, windows)), "last window, voxels"),
        (f"{experiment.grid().size / 1e6:.1f} million", "voxels"),
    ]
    if timings:
        numbers.append((_duration(sum(timings.values())), "computing"))
    items = "".join(f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>" for value, label in numbers)
    return f"<dl>{items}</dl>"


def _warnings(lines: Sequence[str]) -> str:
    if not lines:
        return '<p class="fine">No warnings.</p>'
    items = "".join(f"<li>{escape(str(line))}</li>" for line in lines)
    return f'<section class="warnings"><h2>{len(lines)} warning{"s"[: len(lines) > 1]}</h2><ul>{items}</ul></section>'


def _section(heading: str, words: str, content: Figure | str) -> str:
    if isinstance(content, Figure):
        image = base64.b64encode(png(content)).decode("ascii")
        content = f'<figure><img alt="{escape(heading)}" src="data:image/png;base64,{image}"></figure>'
    words = f"<p>{escape(words)}</p>" if words else ""
    return f"<section><h2>{escape(heading)}</h2>{words}{content}</section>"


def _table(values: Mapping[str, Any], first: str) -> str:
    rows = "".join(f"<tr><th>{escape(str(k))}</th><td>{escape(_text(v))}</td></tr>" for k, v in values.items())
    return f"<table><thead><tr><th>{first}</th><td>value</td></tr></thead><tbody>{rows}</tbody></table>"


def _timings(timings: Mapping[str, float]) -> str:
    longest = max(timings.values()) or 1.0
    rows = "".join(
        f"<tr><th>{escape(stage)}</th><td>{seconds:.2f} s</td>"
        f'<td class="bar"><i style="width:{100 * seconds / longest:.1f}%"></i></td></tr>'
        for stage, seconds in timings.items()
    )
    return f"<table><tbody>{rows}</tbody></table>"


def _listing(text: str) -> str:
    return f"<details><summary>experiment.toml</summary><pre>{escape(text)}</pre></details>"


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, with dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _text(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | np.ndarray):
        return ", ".join(_text(item) for item in value)
    return "–" if value is None else str(value)


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"
