"""The page of ``plenopiv compare``: differences of two results in a table, in slices, in standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from math import isnan
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from plenopiv.comparison import Comparison, Row, Shown
from plenopiv.io.aside import written_aside
from plenopiv.report.document import as_text, page, picture, place_mm, plain, section
from plenopiv.report.figures import COLOURS, INK, SLICES, STYLE, bar, faces, png

LONGEST = 200  # letters of a setting
HEAD = ("depth", "", "vectors", "mean", "RMS", "median", "largest", "RMS", "median", "largest", "> 1 std", "> 2 std")
UNITS = ("mm", "", "", "m/s", "m/s", "m/s", "m/s", "voxels", "voxels", "voxels", "%", "%")


def write_comparison(path: str | Path, found: Comparison) -> None:
    """Write the page, one file.

    Raises:
        PlenoPIVError: it cannot be written; nothing is left behind.
    """
    parts = [
        section("Differences", _words(found), _table(HEAD, UNITS, cells(found.rows)), name="differences"),
        _slices(found),
        _in_deviations(found),
        _settings(found),
    ]
    names = f"<p>A: {plain(found.a)}</p><p>B: {plain(found.b)}</p>"
    body = f"<header><h1>Two results side by side</h1>{names}</header>" + "\n".join(parts)
    with written_aside(path) as aside:
        aside.write_text(page("PlenoPIV: two results side by side", body, found.laboratory), encoding="utf-8")


def what_was_compared(found: Comparison) -> list[str]:
    """Times and vectors, a sentence each."""
    both, only_a, only_b = found.times
    where = "B is interpolated linearly at A's vectors" if found.interpolated else "the vectors are at the same places"
    outside = found.vectors - found.within
    inside = f", {outside:,} of A's lie outside B's region" if outside else ""
    return [
        f"{both:,} time{'s'[: both != 1]} in both, {only_a:,} in A alone, {only_b:,} in B alone; {where}{inside}",
        f"{found.both:,} of {found.within:,} vectors measured in both; {found.replaced[0]:,} replaced in A, "
        f"{found.replaced[1]:,} in B",
    ]


def cells(rows: Sequence[Row]) -> list[list[str]]:
    """The table of differences as text, with the columns of ``HEAD``."""
    found = []
    for depth, group in groupby(rows, lambda row: row.depth_mm):
        for n, row in enumerate(group):
            first = "" if n else "all" if depth is None else f"{depth[0]:.3g} to {depth[1]:.3g}"
            m_s, voxels = row.m_s, row.voxels
            speeds = [_number(v) for v in (m_s.mean, m_s.rms, m_s.median, m_s.largest)]
            steps = ["–"] * 3 if voxels is None else [_number(v) for v in (voxels.rms, voxels.median, voxels.largest)]
            shares = ["–" if isnan(share) else f"{100 * share:.1f}" for share in m_s.beyond]
            found.append([first, row.component, f"{m_s.count:,}", *speeds, *steps, *shares])
    return found


def setting_text(value: object) -> str:
    """A setting's value on one line, not too long."""
    text = " ".join((str(value) if isinstance(value, list) else as_text(value)).split())  # lists with brackets
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


@rc_context(STYLE)
def slices_figure(shown: Shown, across: str) -> Figure:
    """A, B and B - A in the middle plane of a slice ("xy", "xz" or "zy"), a row for each component; where one of them
    was not measured the difference is left out."""
    right, up, normal, *_ = SLICES[across]
    axes_mm = dict(zip("xyz", shown.axes_mm, strict=True))
    h, v = axes_mm[right], axes_mm[up]
    cut = _plane(shown, right, up, normal)
    both = cut(shown.a.measured & shown.b.measured)
    high = float(np.clip(2.6 * np.ptp(faces(v)) / np.ptp(faces(h)), 1.2, 4.0))
    figure = Figure(figsize=(12.5, 3 * high + 0.8), layout="constrained")
    for n, (component, row) in enumerate(zip("uvw", figure.subplots(3, 3), strict=True)):
        a, b = cut(shown.a.velocity[n]), cut(shown.b.velocity[n])
        difference = np.where(both, b - a, np.nan)
        limits = _limit(a, b), _limit(difference)
        for axes, picture_of, limit in zip(row, (a, b, difference), (limits[0], limits[0], limits[1]), strict=True):
            drawn = axes.imshow(
                picture_of, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(*faces(h), *faces(v)), origin="lower"
            )
            axes.set(xlabel=f"{right} (mm)" if n == 2 else "", ylabel=f"{up} (mm)")
            bar(drawn, axes, f"{component} (m/s)")
        if n == 0:
            for axes, title in zip(row, ("A", "B", "B - A"), strict=True):
                axes.set_title(title, loc="left")
    middle = axes_mm[normal][axes_mm[normal].size // 2]
    figure.suptitle(f"{across} at {normal} = {place_mm(middle, axes_mm[normal])} mm, {shown.when}")
    return figure


@rc_context(STYLE)
def deviations_figure(found: Comparison) -> Figure:
    """Histograms of the differences in standard deviations, with the normal distribution."""
    figure = Figure(figsize=(12.5, 3.2), layout="constrained")
    middle = 0.5 * (found.edges[1:] + found.edges[:-1])
    normal = np.exp(-0.5 * middle**2) / np.sqrt(2 * np.pi)
    row: list[Axes] = list(figure.subplots(1, 3))
    for axes, component, counts in zip(row, "uvw", found.histograms, strict=True):
        if counts.sum():
            axes.stairs(counts / counts.sum() / np.diff(found.edges), found.edges, color=COLOURS[component])
        axes.plot(middle, normal, ":", color=INK, linewidth=1.0)
        axes.set(title=component, xlabel="(B - A) / standard deviation", ylabel="density")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _words(found: Comparison) -> str:
    return (
        f"{'. '.join(what_was_compared(found))}. B - A of vectors that both measured; the median is that of the sizes. "
        "The last columns: the share of differences beyond one and two standard deviations sqrt(std_a² + std_b²); of "
        "independent normal errors 31.7 and 4.6 %. Two results of the same images share most of their errors, and "
        "differ by less."
    )


def _slices(found: Comparison) -> str:
    shown = found.shown
    if shown is None:
        return ""
    names = [name for name in ("xy", "xz") if min(shown.axes_mm["xyz".index(axis)].size for axis in name) > 1]
    pictures = [picture(png(slices_figure(shown, name)), f"A, B and B - A, {name} slice") for name in names]
    first = "The first time at which both measured. " if found.times[0] > 1 else ""
    return section("Slices", f"{first}Differences are drawn where both measured.", *pictures, name="slices")


def _in_deviations(found: Comparison) -> str:
    if not found.histograms.sum():
        return section("In standard deviations", "A result states none.", name="deviations")
    words = "All vectors and times; dotted: independent normal errors. What lies beyond 5 is in the outermost bins."
    chart = picture(png(deviations_figure(found)), "differences in standard deviations", "chart")
    return section("In standard deviations", words, chart, name="deviations")


def _settings(found: Comparison) -> str:
    if found.settings is None:
        return section("Settings", "A result has no experiment.toml beside it.", name="settings")
    if not found.settings:
        return section("Settings", "The experiment files differ in no key.", name="settings")
    rows = [[s.key, setting_text(s.a), setting_text(s.b)] for s in found.settings]
    return section("Settings that differ", "", _table(("key", "A", "B"), (), rows), name="settings")


def _table(head: Sequence[str], units: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(words: Sequence[str]) -> str:
        return f"<tr><th>{plain(words[0])}</th>{''.join(f'<td>{plain(word)}</td>' for word in words[1:])}</tr>"

    top = line(head) + (line(units) if units else "")
    return f'<div class="wide"><table><thead>{top}</thead><tbody>{"".join(map(line, rows))}</tbody></table></div>'


def _number(value: float) -> str:
    return "–" if isnan(value) else f"{value:.3g}"


def _plane(shown: Shown, right: str, up: str, normal: str) -> Callable[[NDArray], NDArray]:
    """A function that cuts the middle plane out of (nz, ny, nx) values, ``up`` along its rows."""
    order = "zyx"
    middle = shown.axes_mm["xyz".index(normal)].size // 2
    left = [axis for axis in order if axis != normal]

    def cut(values: NDArray) -> NDArray:
        plane = np.take(values, middle, order.index(normal))
        return plane if left == [up, right] else plane.T

    return cut


def _limit(*pictures: NDArray) -> float:
    """The largest size but for the topmost 0.5 %."""
    values = np.abs(np.concatenate([p[np.isfinite(p)] for p in pictures]))
    return float(np.percentile(values, 99.5)) or 1.0 if values.size else 1.0
