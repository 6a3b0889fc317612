"""``plenopiv design``: what a camera will do, before it is built."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import Any

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import PRESETS, preset
from plenopiv.cli.info import Lines, camera_lines
from plenopiv.cli.optics_sheet import OpticsSheet
from plenopiv.cli.progress import Progress
from plenopiv.design.sheet import Design, Optics
from plenopiv.design.sheet import design as designed
from plenopiv.design.twin import Twin
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.io.output import OutputFolder
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run import duration, memory

FILE = "design.json"
FRAMES = 2
DENSITIES = (0.5, 1.0, 2.0)  # particles per microlens


def design(
    sheet: str,
    folder: Path | None,
    depth_mm: tuple[float, float] | None,
    densities: Sequence[float],
    simulate: bool,
    compare: bool,
    overwrite: bool,
) -> str:
    """Work out a camera from its optics sheet, or a preset's name; write into ``folder``, if there is one, design.json,
    design.txt and design.png. Returns the text. ``densities``: of the twins; some are chosen where there are none.

    Raises:
        PlenoPIVError: the sheet is wrong, the optics contradict one another, the folder holds a design already, or
            ``densities`` or ``compare`` ask for what is not to be simulated.
    """
    if folder is not None and (folder / FILE).exists() and not overwrite:
        raise PlenoPIVError(f"{folder}: holds a design already; use --overwrite, or another folder")
    for asked, option in ((densities, "--density"), (compare, "--compare")):
        if asked and not simulate:
            raise PlenoPIVError(f"{option}: asks for simulated twins; leave it out, or --no-simulate")
    for density in densities:
        if not 0 < density < inf:
            raise PlenoPIVError(f"--density {density:g}: give positive numbers of particles per microlens")
    if depth_mm is not None and not all(map(isfinite, depth_mm)):
        raise PlenoPIVError(f"--depth {depth_mm[0]:g} {depth_mm[1]:g}: give two finite numbers of mm")
    camera, stated = _camera(sheet)
    depth = depth_mm or stated
    try:
        with Progress() as progress:
            simulated = (densities or DENSITIES) if simulate else ()
            found = designed(camera, depth, densities=simulated, simulate_variants=compare, progress=progress)
    except PlenoPIVError as error:
        raise PlenoPIVError(f"{sheet}: {error}") from None
    text = as_text(found)
    if folder is None:
        return text
    from plenopiv.report.design import design_figure
    from plenopiv.report.figures import png

    with OutputFolder(folder, overwrite=True) as out:
        out.write_json(FILE, found.as_dict() | {"costs": costs(found.optics)})
        out.write_text("design.txt", text + "\n")
        out.write_bytes("design.png", png(design_figure(found)))
    return f"{text}\n\n{folder / FILE}\n{folder / 'design.txt'}\n{folder / 'design.png'}"


def _camera(sheet: str) -> tuple[PlenopticCamera, tuple[float, float] | None]:
    """The camera and, where it is stated, the depth that is lit."""
    if sheet in PRESETS:
        return preset(sheet), None
    known = OpticsSheet(Path(sheet))
    columns, rows = (int(known.number("sensor", side)) for side in ("columns", "rows"))
    return known.camera(columns, rows), known.depth_mm()


def costs(optics: Optics) -> dict[str, float]:
    """Voxels, and what a run on a pair of frames takes, on two threads: GB, s."""
    camera, grid, correlation = optics.camera, optics.measurement.grid, CorrelationSettings(optics.measurement.windows)
    reconstruction = ReconstructionSettings().through(camera)
    takes = duration.of_settings(camera, grid, reconstruction, correlation, threads=2)
    return {
        "voxels": grid.size,
        "memory_gb": memory.of_settings(camera, grid, reconstruction, correlation).peak / 1e9,
        "time_s": takes.run(FRAMES),
    }


def as_text(found: Design) -> str:
    """The design as lines and tables of text."""
    optics, needed = found.optics, costs(found.optics)
    measured = optics.measurement
    sides = " x ".join(f"{hi - lo:.3g}" for lo, hi in measured.limits_mm)
    window = " x ".join(f"{1e3 * side:.0f}" for side in measured.window_mm)
    low, high = measured.limits_mm[2]
    nz, ny, nx = measured.grid.shape
    lines: Lines = [
        *camera_lines(optics.camera),
        ("microlenses", f"{optics.microlenses}, each lights {optics.views} pixels (views)"),
        ("volume", f"{sides} mm, seen by every view from z = {low:g} to {high:g} mm"),
        ("voxels", f"{nx} x {ny} x {nz} = {needed['voxels'] / 1e6:.3g} million"),
        ("last windows", f"{' x '.join(map(str, measured.windows[-1]))} voxels = {window} um"),
        ("a pair", f"about {duration.as_text(needed['time_s'])} and {needed['memory_gb']:.2g} GB on two cores"),
        ("seeding", f"one particle per microlens means {optics.overlap:.2g} in a pixel, averaged over depth"),
    ]
    width = max(len(name) for name, _ in lines)
    parts = ["\n".join(f"{name:<{width}}  {text}" for name, text in lines), _by_depth(optics)]
    if found.best is not None:
        parts += [_seeding(found.twins, found.best), _errors(found.best)]
    return "\n\n".join([*parts, _variants(found)])


def _table(title: str, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = [list(head), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    body = ["  ".join(cell.rjust(n) for cell, n in zip(row, widths, strict=True)) for row in cells]
    return "\n".join([title, *(f"  {line}".rstrip() for line in body)])


def _by_depth(optics: Optics) -> str:
    rows = [
        (
            f"{d.z_mm:+.2f}",
            f"{max(d.field_mm[0], 0):.3g} x {max(d.field_mm[1], 0):.3g}",
            f"{1e3 * d.across_mm:.3g} ({1e3 * d.across_largest_mm:.3g})",
            f"{1e3 * d.in_depth_mm:.3g} ({1e3 * d.in_depth_largest_mm:.3g})",
        )
        for d in optics.depths[::2]
    ]
    title = (
        "Distance that a point moves until another pixel is lit, um: mean (largest). Smaller motions change how its "
        "light is split between pixels, as far as noise allows."
    )
    return _table(title, ("z (mm)", "field (mm)", "across", "in depth"), rows)


def _seeding(twins: Sequence[Twin], best: Twin) -> str:
    rows = []
    for t in twins:
        x, y, z = t.errors.rms
        scored = f"{t.particles_per_window:.0f}", f"{100 * t.candidates:.1f}", f"{100 * t.errors.gross:.1f}"
        bias = f"{t.errors.bias[2]:+.3f}"
        rows.append((f"{t.particles_per_microlens:g}", *scored, f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", bias))
    aim = f"Aim for {best.particles_per_microlens:g} particles per microlens"
    title = f"{aim}. Simulated twins of this camera, uniform motion:"
    head = "ppm", "a window", "candidates %", "gross %", "RMS x", "RMS y", "RMS z", "bias z (voxel)"
    return _table(title, head, rows)


def _errors(twin: Twin) -> str:
    voxel = twin.measurement.voxel_mm
    rows = []
    for plane in twin.planes:
        um = (1e3 * e * d for e, d in zip(plane.rms, voxel, strict=True))
        rows.append((f"{plane.z_mm:+.2f}", *(f"{e:.3f}" for e in plane.rms), *(f"{e:.2f}" for e in um)))
    title = f"Expected error of displacements at {twin.particles_per_microlens:g} ppm (divide by dt for velocities):"
    return _table(title, ("z (mm)", "RMS x", "y", "z (voxel)", "x", "y", "z (um)"), rows)


def _variants(found: Design) -> str:
    rows = []
    twins = found.variant_twins or (None,) * len(found.variants)
    for optics, simulated in zip((found.optics, *found.variants), (found.best, *twins), strict=True):
        (_, _, (lo, hi)), half = optics.measurement.limits_mm, (optics.dead_zone_mm[1] - optics.dead_zone_mm[0]) / 2
        end, middle = max(optics.depths, key=lambda d: abs(d.z_mm)), optics.depths[len(optics.depths) // 2]
        errors = "" if simulated is None else " ".join(f"{e:.3f}" for e in simulated.errors.rms)
        rows.append(
            (
                optics.name,
                optics.microlenses,
                f"{half:.3g}",
                f"{middle.field_mm[0]:.3g} x {middle.field_mm[1]:.3g}",
                f"{lo:.3g} to {hi:.3g}",
                f"{1e3 * middle.across_mm:.3g}",
                f"{1e3 * end.across_mm:.3g}",
                f"{1e3 * middle.in_depth_mm:.3g}",
                f"{1e3 * end.in_depth_mm:.3g}",
                errors,
            )
        )
    density = "" if found.best is None else f", errors at {found.best.particles_per_microlens:g} ppm"
    head = (
        "what changes", "lenses", "dead zone +-mm", "field (mm)", "depth (mm)",
        "across, middle", "far end", "in depth, middle", "far end", "RMS x y z (voxel)" if found.best else "",
    )  # fmt: skip
    title = f"What would change (field and um as above in the middle of the depth, apertures matched anew{density}):"
    return _table(title, head, rows)
