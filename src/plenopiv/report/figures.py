"""The report's figures as PNG and PDF, drawn without matplotlib's global state."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.transforms import Bbox, BboxBase, ScaledTranslation, blended_transform_factory
from numpy.typing import NDArray

from plenopiv.errors import printable
from plenopiv.report.document import place_mm
from plenopiv.report.limits import OF_SPEED, colour_limits
from plenopiv.report.stacks import joined
from plenopiv.report.views import Projections, RawCrop
from plenopiv.velocity import replaced

if TYPE_CHECKING:
    import xarray

INK, BLUE, ORANGE, GREEN = "#1f2933", "#1f6fb2", "#d9822b", "#3c8c4a"
COLOURS = {"u": BLUE, "v": ORANGE, "w": GREEN}
# under dark arrows
MAPS = {
    "sequential": ListedColormap(colormaps["YlGnBu"](np.linspace(0.02, 0.6, 256))),
    "diverging": ListedColormap(colormaps["RdBu_r"](np.linspace(0.1, 0.9, 256))),
}
ARROWS = 26  # along the longer side of a slice
PIXELS = 1200  # more than this along a side is joined, brightest first
DPI, PADDING = 130, 0.1  # of figures, inches around them
TITLE = 18  # points between a title and its axes, with an arrow's key in between
STYLE: Any = {"font.size": 9.0, "axes.titlesize": 10.0, "axes.edgecolor": "#8794a1", "axes.linewidth": 0.8}

# name of a slice: (horizontal axis, vertical axis, normal, in-plane components, component along the normal)
SLICES = {
    "xy": ("x", "y", "z", ("u", "v"), "w"),
    "xz": ("x", "z", "y", ("u", "w"), "v"),
    "zy": ("z", "y", "x", ("w", "v"), "u"),
}


def png(figure: Figure) -> bytes:
    """A figure as PNG, without margins."""
    return Drawn.of(figure).png


@dataclass(frozen=True)
class Drawn:
    """A figure without margins: its pixels, (rows, columns, 4); columns at which panels that stand side by side part;
    a PDF file, where asked for. Without dates, so that the same run writes the same files."""

    pixels: NDArray[np.uint8]
    cuts: tuple[int, ...]
    pdf: bytes = b""

    @staticmethod
    @rc_context(STYLE)
    def of(figure: Figure, pdf: bool = False) -> Drawn:
        """Laid out once, its parts measured once, and drawn once a file, where ``savefig`` does each twice."""
        figure.set_dpi(DPI)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        figure.set_layout_engine("none")
        boxes = [box for axes in figure.axes if (box := axes.get_tightbbox()) is not None]
        words = [part for part in figure.get_children() if part not in figure.axes and part.get_in_layout()]
        all_boxes = [*boxes, *(box for part in words if (box := part.get_tightbbox()) is not None)]
        box = Bbox.union(all_boxes or [figure.bbox]).padded(PADDING * DPI)
        pixels = _cut_out(np.asarray(canvas.buffer_rgba()), box)
        file = io.BytesIO()
        if pdf:
            FigureCanvasPdf(figure).print_pdf(file, metadata={"CreationDate": None})
            figure.set_dpi(DPI)
        return Drawn(pixels, _cuts([(each.x0 - box.x0, each.x1 - box.x0) for each in boxes]), file.getvalue())

    @cached_property
    def png(self) -> bytes:
        """The whole figure."""
        return _png(self.pixels)

    @property
    def panels(self) -> list[bytes]:
        """Its panels, each as PNG without margins: on a narrow page they stand one below the other."""
        if not self.cuts:
            return [self.png]
        found = []
        for first, last in pairwise([0, *self.cuts, self.pixels.shape[1]]):
            part = self.pixels[:, first:last]
            drawn: NDArray[np.bool_] = np.any(part[..., :3] < 255, axis=2)
            rows, columns = (np.flatnonzero(np.any(drawn, axis=axis)) for axis in (1, 0))
            found.append(_png(part[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]))
        return found


def _cut_out(drawn: NDArray[np.uint8], box: BboxBase) -> NDArray[np.uint8]:
    """The part of a ``drawn`` figure (rows, columns, 4) within a ``box`` in pixels from its lower left corner; white
    where that reaches beyond it."""
    rows, columns = drawn.shape[:2]
    left, right, bottom, top = (round(side) for side in (box.x0, box.x1, box.y0, box.y1))
    sides = max(top - rows, 0), max(-bottom, 0), max(-left, 0), max(right - columns, 0)
    padded = np.pad(drawn, (sides[:2], sides[2:], (0, 0)), constant_values=255)
    first_row, first_column = rows - top + sides[0], left + sides[2]
    return padded[first_row : first_row + top - bottom, first_column : first_column + right - left]


def _cuts(spans: list[tuple[float, float]]) -> tuple[int, ...]:
    """Between what stands side by side; colour bars lie within the spans of their axes (pixels)."""
    spans = sorted(spans)
    cuts: list[int] = []
    end = spans[0][1] if spans else 0.0
    for x0, x1 in spans[1:]:
        if x0 > end - 0.03 * DPI:  # layouts let panels touch
            cuts.append(round(0.5 * (x0 + end)))
        end = max(end, x1)
    return tuple(cuts)


def _png(pixels: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    imsave(buffer, pixels, format="png")
    return buffer.getvalue()


@rc_context(STYLE)
def raw_figure(crops: Sequence[RawCrop]) -> Figure:
    """Raw pixels with the circles of the lattice drawn over them."""
    figure = Figure(figsize=(4.3 * len(crops), 4.4), layout="constrained")
    for axes, crop in zip(_row(figure, len(crops)), crops, strict=True):
        rows, columns = crop.counts.shape
        column, row = crop.corner
        extent = (column - 0.5, column + columns - 0.5, row + rows - 0.5, row - 0.5)
        top = float(np.percentile(crop.counts, 99.8))
        picture = axes.imshow(crop.counts, cmap="gray", vmin=float(crop.counts.min()), vmax=top, extent=extent)
        size = np.full(len(crop.centres_px), 2 * crop.radius_px)
        circles = EllipseCollection(size, size, size * 0, units="x", offsets=crop.centres_px, linewidth=0.8)
        circles.set(offset_transform=axes.transData, facecolor="none", edgecolor=ORANGE)
        axes.add_collection(circles)
        axes.plot(*crop.centres_px.T, ".", color=ORANGE, markersize=2)
        axes.set_title(written(crop.name), parse_math=False)
        axes.set(xlabel="column (px)", ylabel="row (px)")
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        bar(picture, axes, "counts")
    return figure


@rc_context(STYLE)
def volume_figure(views: Projections) -> Figure:
    """The brightest voxels along z and along y."""
    (x0, x1), (y0, y1), (z0, z1) = views.limits_mm
    figure = Figure(figsize=(12.5, 4.8), layout="constrained")
    for axes, image, extent, label, along in zip(
        _row(figure, 2),
        (views.xy, views.xz),
        ((x0, x1, y0, y1), (x0, x1, z0, z1)),
        ("y (mm)", "z (mm)"),
        "zy",
        strict=True,
    ):
        lit = image[image > 0]
        top = float(np.percentile(lit, 99.5)) if lit.size else 1.0
        picture = axes.imshow(
            joined(image, PIXELS),
            cmap="gray_r",
            vmin=0,
            vmax=top,
            extent=extent,
            origin="lower",
            interpolation="nearest",
        )
        axes.set(title=f"brightest voxel along {along}", xlabel="x (mm)", ylabel=label)
        bar(picture, axes, "intensity (counts)")
    return figure


@rc_context(STYLE)
def velocity_figure(dataset: xarray.Dataset) -> Figure:
    """Three slices through the middle: colour along the normal, arrows in the plane, crosses where replaced."""
    shown = dataset.isel(time=0)
    figure = Figure(figsize=(12.5, 4.4), layout="constrained")
    longest = max(_largest(np.hypot(shown[a].values, shown[b].values)) for *_, (a, b), _ in SLICES.values())
    fastest = _largest(np.sqrt(sum(shown[name].values.astype(float) ** 2 for name in "uvw")))
    for axes, (name, (right, up, normal, inside, through)) in zip(_row(figure, 3), SLICES.items(), strict=True):
        middle = shown.sizes[normal] // 2
        plane = shown.isel({normal: middle}).transpose(up, right, ...)
        h, v = plane[right].values, plane[up].values
        colour = plane[through].values
        kind, low, high = colour_limits(colour, OF_SPEED * fastest)
        extent = (*faces(h), *faces(v))
        picture = axes.imshow(colour, cmap=MAPS[kind], vmin=low, vmax=high, extent=extent, origin="lower")
        step = max(1, -(-max(h.size, v.size) // ARROWS))
        cut = (slice(None, None, step), slice(None, None, step))
        spacing = step * min((abs(a[1] - a[0]) for a in (h, v) if a.size > 1), default=1.0)
        scale = (longest or 1.0) / (1.6 * spacing)  # m/s in a mm
        axes.quiver(
            h[::step], v[::step], plane[inside[0]].values[cut], plane[inside[1]].values[cut],
            color=INK, angles="xy", scale_units="xy", scale=scale, width=0.004, pivot="mid",
        )  # fmt: skip
        crossed = replaced(plane).values
        if crossed.any():
            rows, columns = np.nonzero(crossed)
            axes.plot(h[columns], v[rows], "x", color=INK, markersize=3, alpha=0.6)
        position = float(shown[normal].values[middle])
        axes.set_title(f"{name} at {normal} = {place_mm(position, shown[normal].values)} mm", loc="left", pad=TITLE)
        arrow_key(axes, extent[0], _round(longest) / scale, f"{_round(longest):g} m/s")
        axes.set(xlabel=f"{right} (mm)", ylabel=f"{up} (mm)")
        bar(picture, axes, f"{through} (m/s)")
    return figure


@rc_context(STYLE)
def histogram_figure(dataset: xarray.Dataset, voxel_mm: Sequence[float], dt_s: float) -> Figure:
    """Displacements as measured, what they leave of a whole voxel, and how clear their peaks were."""
    figure = Figure(figsize=(12.5, 3.3), layout="constrained")
    left, middle, right = _row(figure, 3)
    ratio = dataset["peak_ratio"].values if "peak_ratio" in dataset else np.ones(dataset["u"].shape)
    has_peak = ratio > 0  # a window without light has neither peak nor displacement
    for name, voxel in zip("uvw", voxel_mm, strict=True):
        measured = _raw(dataset, name)
        displacement = measured[np.isfinite(measured) & has_peak] * 1e3 * dt_s / voxel
        if not displacement.size:
            continue
        lo, hi = np.percentile(displacement, (0.5, 99.5))
        bins = np.linspace(lo - 0.1, hi + 0.1, 60).tolist()
        axis = {"u": "x", "v": "y", "w": "z"}[name]
        left.hist(displacement, bins, histtype="step", color=COLOURS[name], label=f"along {axis}", linewidth=1.4)
        fraction = displacement - np.rint(displacement)
        middle.hist(
            fraction,
            np.linspace(-0.5, 0.5, 26).tolist(),
            histtype="step",
            color=COLOURS[name],
            density=True,
            linewidth=1.4,
        )
    left.set(title="displacement as measured", xlabel="voxels per frame", ylabel="vectors")
    left.set_ylim(top=1.2 * left.get_ylim()[1])
    if left.get_legend_handles_labels()[0]:
        left.legend(frameon=False, ncols=3, loc="upper center")
    middle.axhline(1.0, color="#8794a1", linewidth=0.8, linestyle=":")
    middle.set(title="displacement minus whole voxels", xlabel="voxels", ylabel="density")
    if "peak_ratio" in dataset and has_peak.any():
        ratio = ratio[has_peak]
        right.hist(np.minimum(ratio, 10.0), np.linspace(1, 10, 46).tolist(), color=BLUE)
    right.set(title="highest peak over second", xlabel="peak ratio (10 and more at 10)", ylabel="vectors")
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def arrow_key(axes: Axes, left: float, length: float, text: str) -> None:
    """How long an arrow of some value is, above the axes and below a title with the pad ``TITLE``: ``length`` from
    ``left``, on the horizontal axis."""
    above = ScaledTranslation(0, 8 / 72, axes.figure.dpi_scale_trans)
    place = blended_transform_factory(axes.transData, axes.transAxes) + above
    shape = {"arrowstyle": "-|>", "color": INK, "shrinkA": 0, "shrinkB": 0}
    given: Any = {"xycoords": place, "annotation_clip": False}
    for drawn in (
        axes.annotate("", (left + length, 1), (left, 1), textcoords=place, arrowprops=shape, **given),
        axes.annotate(text, (left + length, 1), (5, 0), textcoords="offset points", va="center", **given),
    ):
        drawn.set_in_layout(False)  # the title's pad is its room


def bar(picture: ScalarMappable, axes: Axes, label: str) -> None:
    """A colour bar as high as its axes."""
    axes.figure.colorbar(picture, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)), label=label)


def _row(figure: Figure, n: int) -> list[Axes]:
    return list(np.atleast_1d(figure.subplots(1, n)))


def _raw(dataset: xarray.Dataset, name: str) -> NDArray:
    raw = f"{name}_raw"
    return dataset[raw if raw in dataset else name].values


def written(name: str) -> str:
    """A file's name as matplotlib can write it: printable, not too long, no label that it would leave out."""
    plain = printable(name)
    plain = plain if len(plain) <= 40 else f"{plain[:37]}..."
    return f" {plain}" if plain.startswith("_") else plain


def faces(centres: NDArray) -> tuple[float, float]:
    """Outer faces of cells around evenly spaced centres."""
    half = 0.5 * abs(centres[1] - centres[0]) if centres.size > 1 else 0.5
    return float(centres.min() - half), float(centres.max() + half)


def _largest(values: NDArray) -> float:
    """The 99th percentile of the absolute values: one wild vector must not fade all others."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, 99)) if finite.size else 0.0


def _round(value: float) -> float:
    """To one digit, for a key that reads well."""
    return float(f"{value:.0e}") if value > 0 else 1.0
