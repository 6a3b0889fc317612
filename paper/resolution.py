"""The paper's section 2: what PMR 8, 14 and 28 resolve. Draws Figs. 3 to 6 anew and measures what the text claims.

python paper/resolution.py              pictures to docs/images/paper, numbers to paper/results/resolution.json
python paper/resolution.py --reduced --out FOLDER      the same from a coarse raster, all to FOLDER
"""

from __future__ import annotations

import argparse
import json
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm
from PIL import Image

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.design import (
    Blocks,
    block_sizes,
    blocks,
    boundary_lines,
    corners_mm,
    fan_mm,
    mean_free_shift,
    places_mm,
    portion_edges_mm,
    resolution_y,
    resolution_z,
    xy_plane,
    yz_plane,
)

ROOT = Path(__file__).parents[1]
PICTURES, RESULTS = ROOT / "docs" / "images" / "paper", ROOT / "paper" / "results"
CAMERAS = {"pmr8": 4, "pmr14": 5, "pmr28": 6}  # and the paper's figure
INK, BLUE, ORANGE, GREEN, RED = "#1f2933", "#1f6fb2", "#d9822b", "#3c8d4f", "#c0392b"
COLOUR = {"pmr8": BLUE, "pmr14": ORANGE, "pmr28": GREEN}
Z_MM, Y_MM = (-1.0, 1.0), (-0.3, 0.3)  # the window of Figs. 4 to 6
DEPTHS_MM = (0.0, 0.15, 0.4, 0.9)  # of the x-y panels
PANEL_MM = 0.12  # half their width
BANDS_MM = ((0.0, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.0))  # of |z|
AREA_UM2 = LogNorm(1.0, 1e5)
COLOURS = plt.get_cmap("YlGnBu_r")


def pmr(name: str) -> int:
    """Pixels per microlens of one of the cameras."""
    return round(preset(name).pixels_per_microlens)


def shaded(ax: Axes, found: Blocks, outline: float) -> PolyCollection:
    """Blocks as polygons, light where they are large, with outlines of a width in points."""
    polygons = PolyCollection(
        list(found.polygon), array=1e6 * found.area_mm2, cmap=COLOURS, norm=AREA_UM2, edgecolor=INK, lw=outline
    )
    ax.add_collection(polygons)
    return polygons


def save(figure: plt.Figure, file: Path) -> None:
    """Write a figure, with few colours: lines over shades make large files otherwise."""
    file.parent.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=100, facecolor="white")
    Image.open(drawn).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(file, optimize=True)
    plt.close(figure)


def draw_one_block(camera: PlenopticCamera, file: Path) -> None:
    """Fig. 3: light traced back from the edges of the central microlens; left the way of it, right to scale."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), layout="constrained", width_ratios=[1.15, 1])
    lens = camera.main_lens
    so, si, radius, focus = lens.object_distance_mm, lens.image_distance_mm, 0.5 * lens.aperture_mm, 0.5
    enlarged = 0.3 * radius  # half of the microlens in the picture
    for end, colour in ((radius, GREEN), (-radius, BLUE)):
        for edge, style in ((-enlarged, "-"), (enlarged, "--")):
            image = -edge * so / si  # where the edge is seen at z = 0
            out = image + (image - end) * focus  # and a little beyond
            left.plot([-focus * so, 0, so, so + si], [out, image, end, edge], color=colour, ls=style, lw=1.1)
    left.plot([0, 0], [-radius, radius], color=INK, lw=0.8, ls=":")
    left.annotate("", (so, radius * 1.12), (so, -radius * 1.12), arrowprops={"arrowstyle": "<->", "color": INK})
    left.plot([so + si] * 2, [-enlarged, enlarged], color=RED, lw=3)
    left.plot([so + si] * 2, [-radius, radius], color=INK, lw=0.8)
    left.plot([so + si + 14] * 2, [-radius, radius], color=INK, lw=0.8)
    tip = focus_block(so, radius, enlarged * so / si)
    left.fill(*tip, color=COLOURS(0.95), ec=INK, lw=0.8, zorder=0)
    for z, name in ((0, "focal plane"), (so, "main lens"), (so + si, "MLA"), (so + si + 14, "CCD")):
        left.text(z, -1.22 * radius, name, ha="left" if name == "CCD" else "center", va="top", fontsize=8)
    left.text(
        0.5 * so, 1.12 * radius, "solid: lower edge of the microlens\ndashed: upper edge", ha="center", fontsize=8
    )
    left.set(title="outermost rays traced back (microlens enlarged)", xlabel="z (mm), toward the camera")
    left.set(ylim=(-1.45 * radius, 1.5 * radius), xlim=(-52, so + si + 32), yticks=[])
    left.spines["left"].set_visible(False)

    half, depth = 0.5 * camera.lattice.pitch_mm, np.array([-0.5, 0.5])
    found = blocks(camera, yz_plane(), (-0.5, 0.5), (-0.08, 0.08), (81, 81))
    block = found.polygon[found.label[40, 40]]
    right.fill(*block.T, color=COLOURS(0.95), zorder=0)
    edges = portion_edges_mm(camera)
    for t, style in ((-half, "-"), (half, "--")):
        for v in edges:
            outer = {edges[-1]: GREEN, edges[0]: BLUE}.get(v)
            y = (t - camera.spread(depth) * v) / camera.scale(depth)
            right.plot(depth, y, color=outer or INK, ls=style, lw=1.4 if outer else 0.3, zorder=2 if outer else 1)
    microlens_rulers(right, camera)
    right.plot([], [], color=GREEN, label="top portion's rim")
    right.plot([], [], color=BLUE, label="bottom portion's rim")
    right.plot([], [], color=INK, lw=0.5, label="boundaries between portions")
    lo, hi = camera.dead_zone_mm()
    right.set(title=f"to scale: the block ends at z = {lo:.3f} and {hi:+.3f} mm", xlim=depth, ylim=(-0.08, 0.08))
    right.set(xlabel="z (mm), toward the camera", ylabel="y (mm)")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False, fontsize=8, ncols=3)
    save(figure, file)


def focus_block(so: float, radius: float, half: float) -> tuple[list[float], list[float]]:
    """Corners (z), (y) of the rhombus between the rays from +-``radius`` on the main lens through y = +-``half``."""
    return [-half * so / (radius - half), 0, half * so / (radius + half), 0], [0, half, 0, -half]


def microlens_rulers(ax: Axes, camera: PlenopticCamera) -> None:
    """Two red lines one microlens apart in the focal plane, as the paper's."""
    for side in (-0.5, 0.5):
        ax.axhline(side * camera.lattice.pitch_mm / abs(camera.main_lens.magnification), color=RED, lw=1.8, zorder=3)


def draw_blocks(name: str, found: Blocks, file: Path, reduced: bool) -> None:
    """Figs. 4, 5, 6: blocks of the y-z plane, with the light columns' boundaries, and of x-y planes at a few depths."""
    camera = preset(name)
    figure = plt.figure(figsize=(10.5, 7.2), layout="constrained")
    rows = figure.subfigures(2, 1, height_ratios=[1.7, 1])
    ax = rows[0].subplots()
    colour = shaded(ax, found, 0.0)
    lines = boundary_lines(camera, Z_MM, Y_MM)
    ends = np.array(Z_MM)
    height = (lines[:, 1:] - camera.spread(ends) * lines[:, :1]) / camera.scale(ends)
    ax.add_collection(
        LineCollection(list(np.stack([np.broadcast_to(ends, height.shape), height], 2)), colors=INK, lw=0.3)
    )
    microlens_rulers(ax, camera)
    ax.set(xlim=Z_MM, ylim=Y_MM, xlabel="z (mm), toward the camera", ylabel="y (mm)")
    ax.set_title(f"PMR {pmr(name)}: light columns and blocks in the y-z plane; red: one microlens")
    bar = rows[0].colorbar(colour, ax=ax)
    bar.set_label("area of a block (um$^2$)")
    both = np.concatenate([fan_mm(camera, "x"), fan_mm(camera, "y")])
    for ax, z in zip(rows[1].subplots(1, len(DEPTHS_MM), sharey=True), DEPTHS_MM, strict=True):
        side = (-PANEL_MM, PANEL_MM)
        shaded(ax, blocks(camera, xy_plane(z), side, side, (100, 100) if reduced else (400, 400), both), 0.25)
        ax.set(xlim=side, ylim=side, aspect="equal", xlabel="x (mm)", title=f"x-y plane, z = {z:g} mm")
    rows[1].axes[0].set_ylabel("y (mm)")
    save(figure, file)


def draw_resolution(z: np.ndarray, found: dict[str, dict[str, Any]], file: Path) -> None:
    """Free shift along y and z against depth: mean above, largest below."""
    figure, axes = plt.subplots(2, 2, figsize=(10.5, 6.4), layout="constrained", sharex=True, sharey="col")
    for name, shifts in found.items():
        for column, axis in zip(axes.T, "yz", strict=True):
            for ax, value in zip(column, shifts[axis], strict=True):
                ax.plot(z, 1e3 * value, color=COLOUR[name], lw=1.0, label=f"PMR {pmr(name)}")
    for row, said in zip(axes, ("mean", "largest"), strict=True):
        row[0].set_ylabel(f"{said} free shift (um)")
        for ax, title in zip(row, ("along y (x alike)", "along z (depth)"), strict=True):
            for limit in preset("pmr14").dead_zone_mm():
                ax.axvline(limit, color=INK, lw=0.8, ls=":")
            ax.set(yscale="log", xlim=(z[0], z[-1]), title=title)
    for ax in axes[1]:
        ax.set_xlabel("z (mm), toward the camera; dotted: dead zone")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), frameon=False, ncols=3, loc="outside lower center")
    save(figure, file)


def sizes(found: Blocks) -> list[dict[str, float]]:
    """Area-weighted mean size of blocks of the y-z plane in each band of |z|."""
    rows = []
    for low, high in BANDS_MM:
        depth = np.abs(found.across_mm)
        zone = np.broadcast_to((depth >= low) & (depth < high), found.label.shape)
        size = block_sizes(found, zone)
        rows.append({
            "from_mm": low, "to_mm": high, "area_um2": 1e6 * size.area_mm2, "along_z_um": 1e3 * size.across_mm,
            "along_y_um": 1e3 * size.up_mm,
        })  # fmt: skip
    return rows


def shifts_by_depth(z: np.ndarray, shifts: dict[str, Any]) -> list[dict[str, float]]:
    """Mean free shifts in um over the depths of each band of |z|, and the largest."""
    rows = []
    for low, high in BANDS_MM:
        of = (np.abs(z) >= low) & (np.abs(z) < high)
        row = {"from_mm": low, "to_mm": high}
        for axis, shift in shifts.items():
            row[f"{axis}_mean_um"] = 1e3 * float(shift.mean_mm[of].mean())
            row[f"{axis}_largest_um"] = 1e3 * float(shift.largest_mm[of].max())
        rows.append(row)
    return rows


def in_space(name: str, depths: np.ndarray, places: int) -> dict[str, list[float]]:
    """Mean free shift along y and z in um when all portion corners of the round aperture count, for both lattices."""
    square, hexagonal = (preset(name, lattice=kind) for kind in ("square", "hexagonal"))
    found = {"square_y_um": resolution_y(square, depths)}
    for key, camera, direction in (
        ("square_z_um", square, (0, 0, 1)),
        ("hexagonal_y_um", hexagonal, (0, 1, 0)),
        ("hexagonal_z_um", hexagonal, (0, 0, 1)),
    ):
        image = places_mm(camera.lattice, places)
        found[key] = mean_free_shift(camera, depths, direction, corners_mm(camera), image)
    return {key: (1e3 * shift.mean_mm).tolist() for key, shift in found.items()}


def main(reduced: bool = False, out: Path | None = None) -> dict[str, Any]:
    """Draw and measure; ``out`` takes pictures and numbers, by default they go where the documents find them."""
    plt.rcParams.update({"font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False})
    pictures, results = (PICTURES, RESULTS) if out is None else (out, out)
    raster = (300, 250) if reduced else (1200, 1000)
    z = np.linspace(-2.0, 2.0, 81 if reduced else 801)
    bands = np.linspace(-0.9975, 0.9975, 40 if reduced else 400)
    space = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])[: 3 if reduced else None]
    shifts, numbers = {}, {}
    for name, figure in CAMERAS.items():
        camera = preset(name)
        places = 50 if reduced else 400
        found = blocks(camera, yz_plane(), Z_MM, Y_MM, raster)
        draw_blocks(name, found, pictures / f"fig{figure:02d}-{name}.png", reduced)
        shifts[name] = {"y": resolution_y(camera, z), "z": resolution_z(camera, z, places)}
        centre = blocks(camera, yz_plane(), (-0.5, 0.5), (-0.1, 0.1), (1, 1))
        numbers[name] = {
            "lines": len(boundary_lines(camera, Z_MM, Y_MM)),
            "blocks": len(found.polygon),
            "block_about_focus_z_mm": [float(centre.polygon[0, :, 0].min()), float(centre.polygon[0, :, 0].max())],
            "block_about_focus_y_um": 1e3 * float(centre.extent_mm[0, 1]),
            "dead_zone_mm": list(camera.dead_zone_mm()),
            "blocks_by_depth": sizes(found),
            "free_shift_by_depth": shifts_by_depth(
                bands, {"y": resolution_y(camera, bands), "z": resolution_z(camera, bands, places)}
            ),
            "in_space": {"z_mm": space.tolist(), **in_space(name, space, 8 if reduced else 36)},
        }
        print(f"{name}: {numbers[name]['lines']} lines, {numbers[name]['blocks']} blocks", flush=True)
    draw_one_block(preset("pmr14"), pictures / "fig03-block.png")
    draw_resolution(z, shifts, pictures / "resolution.png")
    results.mkdir(parents=True, exist_ok=True)
    (results / "resolution.json").write_text(json.dumps(rounded(numbers), indent=1) + "\n")
    return numbers


def rounded(value: Any) -> Any:
    """Floats to five significant digits: what the numbers are good for."""
    if isinstance(value, dict):
        return {key: rounded(v) for key, v in value.items()}
    if isinstance(value, list):
        return [rounded(v) for v in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reduced", action="store_true", help="a coarse version, in seconds")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for pictures and numbers alike")
    arguments = parser.parse_args()
    main(arguments.reduced, arguments.out)
