"""Figures of the comparison: slices and vortices of DNS, LF-PIV and Tomo-PIV (the paper's Fig. 10), errors by depth."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from comparison_settings import DEPTH_MM, JET_M_S, TARGET_DEPTH_MM, Comparison
from isosurface import isosurface
from matplotlib import rc_context
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from PIL import Image

from plenopiv.report.figures import BLUE, GREEN, ORANGE, STYLE
from plenopiv.simulation.flows import flow

Array = NDArray[np.float64]
SHORT = {
    "light_field": "LF-PIV",
    "light_field_inner": "LF-PIV, sub-windows",
    "exact": "exact volumes",
    "exact_inner": "exact volumes, sub-windows",
    "two": "LF-PIV, two cameras",
    "two_inner": "two cameras, sub-windows",
    "tomo": "Tomo-PIV, the paper's",
    "matched": "Tomo-PIV, matched",
    "matched_inner": "matched, sub-windows",
}
GREY, VIOLET = "#8794a1", "#8557a8"
IN_WINDOWS = "DNS in LF-PIV's windows"
DRAWN = "light_field", "light_field_inner", "two", "tomo", "matched"  # beside the DNS
COLOURS = {"light_field": BLUE, "exact": GREY, "two": VIOLET, "tomo": ORANGE, "matched": GREEN}
SLICE_Z_MM = 1.5  # of the x-y plane: near focus, out of the zone without depth
SLICE_JET_Y_MM = 1.0  # of the x-z plane, from the jet's axis
AT_MOST_BESIDE = 4  # panels, where they are wider than high
FINE_MM = 0.15  # spacing at which the DNS is drawn
LEVELS = np.linspace(-0.1, 1.1, 13)
VORTEX_JET2 = 1.0  # Q of the isosurface, in units of (U / D)^2
JET_DIAMETER_MM = 6.0
KEPT = Path(__file__).parent / "results" / "fields"  # of the full size, which takes hours


def field_file(fields: Path, setting: Comparison, name: str) -> Path | None:
    """A field as it was measured, or what is KEPT of it; None if neither is there."""
    files = (folder / f"{setting.name}-{name}.nc" for folder in (fields, KEPT))
    return next((file for file in files if file.exists()), None)


def keep(fields: Path, setting: Comparison, name: str, folder: Path = KEPT) -> None:
    """Write what figures show of a field into ``folder``: velocities to 0.05 mm/s, half a megabyte."""
    field = shown(fields, setting, name)[[*"uvw", "u_true", "v_true", "w_true", "judged"]]
    short = {"dtype": "int16", "scale_factor": 1e-4, "_FillValue": -(2**15)}
    packed = {"zlib": True, "complevel": 9, "shuffle": True}
    encoding = {v: packed | ({} if v == "judged" else short) for v in map(str, field.data_vars)}
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{setting.name}-{name}.nc"
    field.drop_vars([c for c in field.coords if c not in field.dims]).to_netcdf(
        file, engine="h5netcdf", encoding=encoding
    )


def shown(fields: Path, setting: Comparison, name: str) -> xr.Dataset:
    """A field where its vectors are judged. Raises FileNotFoundError where it is not there."""
    found = field_file(fields, setting, name)
    if found is None:
        raise FileNotFoundError(f"{fields / f'{setting.name}-{name}.nc'}: measure it first")
    with xr.open_dataset(found, engine="h5netcdf") as file:
        field = file.load()
    judged = field.judged.values.astype(bool)
    z, y, x = (np.flatnonzero(judged.any(tuple(k for k in range(3) if k != axis))) for axis in range(3))
    return field.isel(z=z, y=y, x=x)


def sampled(setting: Comparison, x: Array, y: Array, z: Array) -> xr.Dataset:
    """The DNS on a grid of its own."""
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    jet = flow("jet", at_mm=setting.jet_at_mm)
    velocity = jet(np.stack([xx, yy, zz], -1).reshape(-1, 3)).reshape(*zz.shape, 3)
    names = {c: (("z", "y", "x"), velocity[..., k]) for k, c in enumerate("uvw")}
    return xr.Dataset(names, {"x": x, "y": y, "z": z})


def dns_over(setting: Comparison, field: xr.Dataset) -> xr.Dataset:
    """The DNS where a field has vectors, at FINE_MM or a little less."""
    ends = (field[c].values[[0, -1]] for c in "xyz")
    return sampled(setting, *(np.linspace(lo, hi, int((hi - lo) / FINE_MM) + 2) for lo, hi in ends))


def true(field: xr.Dataset) -> xr.Dataset:
    """The DNS in a field's windows."""
    return field[["u_true", "v_true", "w_true"]].rename({f"{c}_true": c for c in "uvw"})


def at_plane(field: xr.Dataset, axis: str, place_mm: float) -> xr.Dataset:
    """A slice at ``place_mm``, or at the nearest end of the field."""
    ends = field[axis].values[[0, -1]]
    return field.interp({axis: float(np.clip(place_mm, *ends))})


@rc_context(STYLE)
def slices(fields: dict[str, xr.Dataset], setting: Comparison) -> Figure:
    """Contours of u in an x-y and an x-z plane."""
    light = fields["light_field"]
    both = {"DNS": dns_over(setting, light), IN_WINDOWS: true(light)}
    both |= {SHORT[name]: field for name, field in fields.items()}
    limits = {c: tuple(light[c].values[[0, -1]]) for c in "xyz"}
    width, height, depth = (high - low for low, high in limits.values())
    columns = len(both) if depth > width else AT_MOST_BESIDE
    blocks = -(-len(both) // columns)
    inch = 14.0 / (columns * width)  # for a mm
    figure = Figure(figsize=(15.5, blocks * (inch * (height + depth) + 1.0)), layout="constrained")
    ratios = [height, depth] * blocks
    panels = figure.subplots(2 * blocks, columns, sharex=True, sharey="row", height_ratios=ratios, squeeze=False)
    planes = (("z", SLICE_Z_MM, "y"), ("y", SLICE_JET_Y_MM - setting.jet_at_mm[1], "z"))
    for n, (title, field) in enumerate(both.items()):
        block, column = divmod(n, columns)
        for row, (axis, place, upward) in enumerate(planes, 2 * block):
            axes, plane = panels[row, column], at_plane(field, axis, place).transpose(upward, "x")
            filled = axes.contourf(plane.x, plane[upward], plane.u / JET_M_S, LEVELS, cmap="viridis", extend="both")
            axes.contour(plane.x, plane[upward], plane.u / JET_M_S, LEVELS[3::2], colors="white", linewidths=0.4)
            axes.set(xlim=limits["x"], ylim=limits[upward], aspect="equal", facecolor="#e4e8ec")
            where = f"{axis} = {float(plane[axis]):.1f} mm"
            axes.set_title(f"{title}\n{where}" if axis == "z" else where)
            if column == 0:
                axes.set_ylabel(f"{upward}, mm" + (", toward the camera" if upward == "z" else ""))
            if n + columns >= len(both) and upward == "z":
                axes.set_xlabel("x, mm")
                axes.tick_params(labelbottom=True)
    for axes in panels.flat:
        axes.set_visible(axes.has_data())
    figure.colorbar(filled, ax=panels, label="u / U", shrink=0.7)
    return figure


@rc_context(STYLE)
def errors(results: dict[str, Any]) -> Figure:
    """RMS error against depth, with the stated standard deviation or, where there is sub-window averaging, with what
    those leave; a panel for each component."""
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    panels = figure.subplots(1, 3)
    for component, (axes, symbol) in enumerate(zip(panels, "uvw", strict=True)):
        for name, colour in COLOURS.items():
            inner = f"{name}_inner"
            other = (inner, "rms_mm_s", "s--") if inner in SHORT else (name, "stated_mm_s", ":")
            for of, key, style in ((name, "rms_mm_s", "o-"), other):
                bands = results["cases"][of]["errors"]["window_mean"]
                depths = {b: np.mean([float(v) for v in b.split()[0].split("-")]) for b in bands if b.endswith("mm")}
                line = [bands[b][key][component] for b in depths]
                label = SHORT[of] if key == "rms_mm_s" else None
                axes.plot(list(depths.values()), line, style, color=colour, ms=4, lw=1.5, label=label)
        axes.axvline(TARGET_DEPTH_MM, color="#8794a1", lw=0.8, ls="--")
        axes.set(title=f"RMS error of {symbol}", xlabel="|z|, mm", xlim=(0, DEPTH_MM[1]), ylim=(0, None))
    panels[0].set_ylabel("mm/s (dotted: as stated)")
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=5, loc="outside lower center")
    return figure


def turning(field: xr.Dataset) -> Array:
    """Q = (|rotation|^2 - |strain|^2) / 2 in 1/s^2, (nz, ny, nx): positive where the fluid turns (Hunt et al. 1988)."""
    field = field.transpose("z", "y", "x")
    axes = [field[c].values * 1e-3 for c in "xyz"]
    g = np.array([[np.gradient(field[c].values, a, axis=2 - k) for k, a in enumerate(axes)] for c in "uvw"])
    return -0.5 * (g * g.swapaxes(0, 1)).sum((0, 1))


@rc_context(STYLE)
def vortices(fields: dict[str, xr.Dataset], setting: Comparison) -> Figure:
    """Isosurfaces of Q, dark where they face away from the light."""
    light, depth = fields["light_field"], TARGET_DEPTH_MM
    both = {IN_WINDOWS: true(light)} | {SHORT[name]: field for name, field in fields.items()}
    level = VORTEX_JET2 * (JET_M_S / (JET_DIAMETER_MM * 1e-3)) ** 2
    columns = -(-len(both) // 2)
    figure = Figure(figsize=(15.5, 8.2))
    figure.subplots_adjust(left=0.02, right=0.96, bottom=0.04, top=0.91, wspace=0.12, hspace=0.1)
    figure.suptitle(f"Q = {VORTEX_JET2:g} (U/D)²")
    limits = [tuple(light[c].values[[0, -1]]) for c in "xyz"]
    limits[2] = max(limits[2][0], -depth), min(limits[2][1], depth)
    for k, (title, field) in enumerate(both.items(), 1):
        axes = figure.add_subplot(2, columns, k, projection="3d")
        inside = field.sel({c: slice(lo - 1e-6, hi + 1e-6) for c, (lo, hi) in zip("xyz", limits, strict=True)})
        if min(inside.sizes.values()) >= 2:
            surface = isosurface(turning(inside), level, tuple(inside[c].values for c in "xyz"))  # type: ignore[arg-type]
            if len(surface):
                corners = surface[:, ::-1, :][:, :, [0, 2, 1]]  # z into the page, y up; a mirror turns faces round
                light_from = LightSource(225, 45)
                axes.add_collection3d(
                    Poly3DCollection(corners, facecolors=BLUE, shade=True, lightsource=light_from, antialiased=False)
                )
        axes.set(xlim=limits[0], ylim=limits[2], zlim=limits[1], xlabel="x, mm", ylabel="z, mm", zlabel="y, mm")
        axes.set_box_aspect([limits[c][1] - limits[c][0] for c in (0, 2, 1)], zoom=1.15)
        axes.locator_params(nbins=4)
        axes.view_init(22, -62)
        axes.set_title(title)
    return figure


def save(figure: Figure, file: Path) -> None:
    """A PNG of few colours: a fifth of the size."""
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=90, facecolor="white")
    Image.open(drawn).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)


def draw(results: dict[str, Any], setting: Comparison, fields: Path, folder: Path, stem: str) -> list[str]:
    """All three figures into ``folder``, their names beginning with ``stem``. Returns what is missing in slices and
    vortices, as its field is not among ``fields``; without LF-PIV's, whose places they show, these are not drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    save(errors(results), folder / f"{stem}-errors.png")
    here = [name for name in DRAWN if field_file(fields, setting, name)]
    if "light_field" not in here:
        return list(DRAWN)
    found = {name: shown(fields, setting, name) for name in here}
    save(slices(found, setting), folder / f"{stem}-slices.png")
    save(vortices(found, setting), folder / f"{stem}-vortices.png")
    return [name for name in DRAWN if name not in here]
