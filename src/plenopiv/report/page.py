"""The page: key numbers, warnings, the field in 3D and in slices, how good it is, what it came from."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from plenopiv.experiment import Experiment
from plenopiv.report import charts, figures, viewers
from plenopiv.report.document import bars, flat, page, pictures, plain, section, subheading, table
from plenopiv.report.facts import facts
from plenopiv.report.field import field_data
from plenopiv.report.moments import Series, are_numbered, named, what_of
from plenopiv.report.stacks import Stack
from plenopiv.report.views import Projections, RawCrop
from plenopiv.velocity import replaced_share, vectors_inside_body

if TYPE_CHECKING:
    import xarray

ALL_TURNS = (
    " Here nearly all of the flow turns more than it deforms, as in a solid-body rotation: a surface would wrap noise "
    "alone, so none is drawn at first."
)
FRAMES = 20  # of a series, whose numbers and residuals are shown
SECTIONS_OF_THEIR_OWN = ("warnings", "timings_s", "peak_memory_gb", "versions")


def write_report(
    path: str | Path,
    *,
    title: str,
    experiment: Experiment,
    summary: Mapping[str, Any],
    dataset: xarray.Dataset,
    crops: Sequence[RawCrop] = (),
    views: Projections | None = None,
    stacks: Sequence[Stack] = (),
    accuracy: Mapping[str, Any] | None = None,
    series: Mapping[str, Sequence[float]] | None = None,
    fields: Series | None = None,
    number: int = 0,
    date: str = "",
    figures_folder: str | Path | None = None,
) -> None:
    """Write the report of a run.

    ``summary`` is what goes to summary.json: its ``warnings`` (a list of lines), ``timings_s`` and ``peak_memory_gb``
    (by stage) and ``versions`` have sections of their own, all else is tabled by dotted key. ``dataset`` is the
    velocity field, dims (time, z, y, x); of several times figures draw the first. ``series``: of several pairs, what
    is plotted over their time (``run.written.series_of``). ``fields``: of several pairs or phases all of them, for
    the 3D scene and the slices, ``dataset`` then that of ``number``, from 0. ``date``: when it was evaluated.
    ``stacks`` are pictures under sliders, named "volume", "views" and "refocus". ``accuracy`` is for recordings whose
    truth is known: measure -> number or text, and under "by_depth" a ``DepthProfile``. ``figures_folder``: where
    figures go as PNG and PDF too.
    """
    drawn = _Figures(None if figures_folder is None else Path(figures_folder))
    leafed = {stack.name: stack for stack in stacks}
    pairs = len(series["time_s"]) if series else fields.count if fields else dataset.sizes["time"]
    parts = [
        *_velocity(dataset, fields, pairs, number, drawn),
        *_series(series or {}, are_numbered(dataset), drawn),
        *_accuracy(accuracy or {}, dataset, drawn),
        _validation(experiment, dataset, summary, pairs, number, drawn),
        _reconstruction(summary, views, leafed, drawn),
        _light_field(crops, leafed, drawn),
        _effort(summary),
        section("Numbers", "The content of summary.json.", table(_others(summary), "key"), name="numbers"),
        _configuration(experiment, summary),
    ]
    body = [
        facts(title, experiment, dataset, summary, pairs, number, date),
        _warnings(list(summary.get("warnings", []))),
        _contents(parts),
        *parts,
    ]
    Path(path).write_text(page(title, "\n".join(body), dataset.attrs.get("frame") == "laboratory"), encoding="utf-8")


def _contents(parts: Sequence[str]) -> str:
    """Links to the sections that there are."""
    found = [match for part in parts if (match := re.match(r'<section id="([\w-]+)"><h2>([^<]*)</h2>', part))]
    links = "".join(f'<a href="#{match[1]}">{match[2]}</a>' for match in found)
    return f'<nav aria-label="Contents">{links}</nav>'


class _Figures:
    """Figures for the page, and into a folder as PNG and PDF where one is given."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def __call__(self, name: str, figure: Figure, words: str, kind: str = "") -> str:
        drawn = figures.Drawn.of(figure, pdf=self.folder is not None)
        if self.folder is not None:
            (self.folder / f"{name}.png").write_bytes(drawn.png)
            (self.folder / f"{name}.pdf").write_bytes(drawn.pdf)
        return pictures(drawn.panels, words, kind)


def _series(series: Mapping[str, Sequence[float]], numbered: bool, drawn: _Figures) -> list[str]:
    if len(series.get("time_s", ())) < 2:
        return []
    over = "number" if numbered else "time"
    words = f"Each pair by its {over}. Where replaced vectors and peak ratio change, light, seeding or focus did."
    figure = drawn("series", charts.series_figure(series, numbered), f"each pair over its {over}", "chart")
    return [section("Series", words, figure, name="series")]


def _velocity(dataset: xarray.Dataset, fields: Series | None, pairs: int, number: int, drawn: _Figures) -> list[str]:
    field = field_data(dataset, fields)
    turning = "" if field["start"] else ALL_TURNS
    every = " x ".join(str(field["step"][axis]) for axis in "xyz")
    thinned = "" if every == "1 x 1 x 1" else f" To keep the page small, one vector in {every} along x, y, z is drawn."
    times = sum(moment["kind"] == "time" for moment in field["moments"])
    each = what_of(dataset)
    some = f"{times} of {pairs} {each}s, evenly chosen" if times < pairs else f"Each of {pairs} {each}s"
    series = f"{some}, and the mean and RMS fluctuation of all valid vectors. " if pairs > 1 else ""
    first = f", of {named(dataset, number)}" if pairs > 1 else ""
    return [
        section(
            "Velocity in 3D",
            f"{series}Drag to turn; hold Ctrl and use the wheel to enlarge; point at a vector to read its values. The "
            "isosurface encloses where the flow turns more than it deforms (Q-criterion), or where its vorticity is "
            "above the level. Derivatives are differences of neighbouring vectors and noisier than these; nothing is "
            f"smoothed.{turning}{thinned}",
            viewers.field_block(field),
            viewers.scene(field),
            name="velocity",
        ),
        section(
            "Slices",
            "One plane of vectors after the other. Arrows: velocity in the slice; crosses: vectors that were replaced.",
            viewers.slices(field),
            subheading(f"Through the middle{first}"),
            drawn("velocity", figures.velocity_figure(dataset), "velocity in three slices through the middle", "chart"),
            name="planes",
        ),
    ]


def _accuracy(accuracy: Mapping[str, Any], dataset: xarray.Dataset, drawn: _Figures) -> list[str]:
    if not accuracy:
        return []
    measures = {name: value for name, value in accuracy.items() if name != "by_depth"}
    content = [table(measures, "measure")]
    if (profile := accuracy.get("by_depth")) is not None:
        content.append(drawn("accuracy", charts.accuracy_figure(profile, dataset), "errors by depth", "chart"))
    return [section("Accuracy", "Against the known truth of this recording.", *content, name="accuracy")]


def _validation(
    experiment: Experiment,
    dataset: xarray.Dataset,
    summary: Mapping[str, Any],
    pairs: int,
    number: int,
    drawn: _Figures,
) -> str:
    """``summary`` is of all vectors, figures are of one of ``pairs``."""
    dt_s, voxel_mm = experiment.recording_table.dt_s, experiment.volume.voxel_mm
    share = 100 * summary.get("replaced_share", replaced_share(dataset))
    first = f", of {named(dataset, number)}" if pairs > 1 else ""
    content = [
        subheading(f"Where vectors were replaced{first}"),
        drawn("validation", charts.validation_figure(dataset), "where vectors were replaced", "chart"),
        subheading(
            f"Displacements before windows were replaced{first}",
            "Peak locking would crowd the middle figure at 0; an even spread is flat, if displacements cover several "
            "voxels.",
        ),
        drawn("displacements", figures.histogram_figure(dataset, voxel_mm, dt_s), "histograms", "chart"),
    ]
    if all(f"{name}_std" in dataset for name in "uvw"):
        content += [
            subheading(
                f"Uncertainty{first}",
                "Standard deviation of each vector: scatter of the particles in its window, and flow that the window "
                "does not resolve. Errors common to both frames are not included.",
            ),
            drawn("uncertainty", charts.uncertainty_figure(dataset), "stated standard deviations", "chart"),
        ]
    words = (
        f"{share:.1f} % of the vectors were replaced by a fit to their neighbours. A few per cent are usual; clusters "
        "show where something is wrong."
    )
    if (inside := summary.get("vectors_inside_body", vectors_inside_body(dataset))) is not None:
        words += f" {inside} vectors lie more than half inside the body: they were not measured, and are left blank."
    return section("Validation", words, *content, name="validation")


def _reconstruction(
    summary: Mapping[str, Any], views: Projections | None, leafed: Mapping[str, Stack], drawn: _Figures
) -> str:
    content = []
    if "volume" in leafed:
        content.append(viewers.stack(leafed["volume"], "plane of the reconstructed volume"))
    if views is not None:
        content += [
            subheading("Seen along z and along y"),
            drawn("volume", figures.volume_figure(views), "maximum projections of the volume", "chart"),
        ]
    frames = summary.get("reconstruction", {})
    residuals = {name: frame["residual_counts_by_iteration"] for name, frame in islice(frames.items(), FRAMES)}
    if residuals:
        content += [
            subheading(
                "Residual",
                "RMS difference between measured and projected pixels during each iteration. It should fall in the "
                "first one or two and then stay. It includes light from outside the volume; much of that lets it rise.",
            ),
            drawn("residuals", charts.residual_figure(residuals), "residual by iteration", "chart narrow"),
        ]
    words = (
        "The first frame's volume. Particles should be small and alike; streaks along z are ghosts, or particles near "
        "the focal plane, where depth cannot be told."
    )
    return section("Reconstruction", words, *content, name="reconstruction") if content else ""


def _light_field(crops: Sequence[RawCrop], leafed: Mapping[str, Stack], drawn: _Figures) -> str:
    content = []
    if crops:
        content += [
            subheading(
                "Raw image with the lattice",
                "Each circle should hold one micro-image, at the sensor's corner as well as in the middle.",
            ),
            drawn("lattice", figures.raw_figure(crops), "raw pixels with the lattice"),
        ]
    for name, heading, words in STACKS:
        if name in leafed:
            content += [subheading(heading, words), viewers.stack(leafed[name], heading)]
    return section("Light field", "The first frame.", *content, name="light-field") if content else ""


STACKS = (
    (
        "views",
        "Sub-aperture views",
        "The scene through one portion of the main lens, from left to right and then from below to above. Particles "
        "away from the focal plane move from view to view; those in it stand still.",
    ),
    (
        "refocus",
        "Refocused through depth",
        "All views added up for one depth: particles there become points, others are blurred.",
    ),
)


def _effort(summary: Mapping[str, Any]) -> str:
    timings, memory = dict(summary.get("timings_s", {})), dict(summary.get("peak_memory_gb", {}))
    content = []
    if timings:
        content += [subheading("Time by stage"), bars([(k, s, f"{s:.2f} s") for k, s in timings.items()])]
    if memory:
        content += [subheading("Peak of memory up to the end of a stage")]
        content += [bars([(k, gb, f"{gb:.2f} GB") for k, gb in memory.items()])]
    return section("Time and memory", "Up to the writing of this page.", *content, name="effort") if content else ""


def _configuration(experiment: Experiment, summary: Mapping[str, Any]) -> str:
    versions = summary.get("versions", {})
    listing = f"<details><summary>experiment.toml</summary><pre>{plain(experiment.dump_toml())}</pre></details>"
    content = [listing, *([table(versions, "version of")] if versions else [])]
    return section("Configuration", "The experiment file, every default written out.", *content, name="configuration")


def _others(summary: Mapping[str, Any]) -> dict[str, Any]:
    shown = {key: value for key, value in summary.items() if key not in SECTIONS_OF_THEIR_OWN}
    if len(shown.get("frames", ())) > FRAMES:
        few = dict(islice(shown["reconstruction"].items(), FRAMES))
        shown |= {"frames": [*few, "..."], "reconstruction": few}
    return flat(shown)


def _warnings(lines: Sequence[str]) -> str:
    if not lines:
        return '<p class="fine">No warnings.</p>'
    items = "".join(f"<li>{plain(line)}</li>" for line in lines)
    return f'<section class="warnings"><h2>{len(lines)} warning{"s"[: len(lines) > 1]}</h2><ul>{items}</ul></section>'
