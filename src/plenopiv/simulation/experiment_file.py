"""The ``experiment.toml`` that goes with a simulated recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from plenopiv.cameras.coverage import coverage
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.sensor import Orientation
from plenopiv.volume import Limits

Settings = Mapping[str, Mapping[str, Any]]  # tables by name

TEMPLATE = """\
# One plenoptic recording, from raw images to a velocity field:  plenopiv run experiment.toml
# Paths are relative to this file. Lengths in mm, times in s, as every key says.

[camera]
kind = "plenoptic"

[camera.main_lens]
focal_length_mm = {focal_length}
aperture_mm = {aperture}
magnification = {magnification}
{blur}
[camera.microlens_array]
lattice = "{lattice}"
pitch_mm = {pitch}
focal_length_mm = {microlens_focal_length}

[camera.sensor]
columns = {columns}
rows = {rows}
pixel_pitch_mm = {pixel_pitch}
bit_depth = {bit_depth}
black_level = {black_level}
{tables}
[recording]
white = "white.tif"            # where the microlenses are
{images}
dt_s = {dt}
orientation = "{orientation}"        # "upright": columns grow with +x, rows with -y; "sensor": turned by 180 degrees

[volume]
x_mm = {x}
y_mm = {y}
z_mm = {z}             # 0 = focal plane, + toward the camera
voxel_mm = {voxel}
{unseen}
{settings}"""

SETTINGS = """\
[reconstruction]
method = "drt-mart"            # "mart", "drt-mart", ...
iterations = 5
relaxation = 0.25

[correlation]
windows = {windows}   # voxels along x, y, z, coarse to fine
overlap = 0.5

[output]
directory = "results\""""

FRAMES = 'frames = ["a.tif", "b.tif"]    # a list, or a glob such as "run7/*.tif"'
UNSEEN = 'unseen = "empty"               # corners that no view sees\n'


def default_voxel_mm(camera: PlenopticCamera) -> tuple[float, float, float]:
    """The paper's voxel (section 4) in the object: 36 mm / 2100 over |M| in the plane, p_l / M^2 in depth."""
    m = abs(camera.main_lens.magnification)
    in_plane = round(36.0 / 2100.0 / m, 12)
    return in_plane, in_plane, round(camera.lattice.pitch_mm / m**2, 10)


def _floats(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def _plain(value: float) -> str:
    """A whole number without its point, as black levels are written."""
    return repr(int(value)) if float(value).is_integer() else repr(float(value))


def experiment_toml(
    camera: PlenopticCamera,
    orientation: Orientation,
    dt_s: float,
    volume_mm: Limits,
    voxel_mm: tuple[float, float, float],
    windows: tuple[tuple[int, int, int], ...],
    *,
    tables: str = "",
    images: str = FRAMES,
    seen_mm: Limits | None = None,
    settings: Settings | None = None,
) -> str:
    """The text of the file; limits and voxels in mm, windows in voxels along x, y, z.

    ``tables``: those of [medium] and [calibration], as text; ``images``: lines of [recording] that name frames and
    other images; ``seen_mm``: the volume as a thin lens in air sees it, where that is another one; ``settings``: tables
    of what is done with the images, such as reconstruction, instead of the usual ones.
    """
    lens, sensor = camera.main_lens, camera.sensor
    return TEMPLATE.format(
        focal_length=float(lens.focal_length_mm),
        aperture=float(lens.aperture_mm),
        magnification=float(lens.magnification),
        blur=f"blur_mm = {float(camera.blur_mm)!r}\n" if camera.blur_mm else "",
        lattice=camera.lattice.kind,
        pitch=float(camera.lattice.pitch_mm),
        microlens_focal_length=float(camera.microlens_focal_length_mm),
        columns=sensor.columns,
        rows=sensor.rows,
        pixel_pitch=float(sensor.pixel_pitch_mm),
        bit_depth=sensor.bit_depth,
        black_level=_plain(sensor.black_level),
        dt=float(dt_s),
        orientation=orientation,
        x=_floats(volume_mm[0]),
        y=_floats(volume_mm[1]),
        z=_floats(volume_mm[2]),
        voxel=_floats(voxel_mm),
        tables=tables,
        images=images,
        unseen=UNSEEN if coverage(camera, seen_mm or volume_mm).no_view else "",
        settings=_settings(settings, [list(map(int, w)) for w in windows]),
    )


def _settings(stated: Settings | None, windows: list[list[int]]) -> str:
    """Tables of reconstruction, correlation and output; results are beside the recording, whatever is ``stated``."""
    if stated is None:
        return SETTINGS.format(windows=windows)
    import tomli_w

    tables = {name: dict(table) for name, table in stated.items()}
    tables["correlation"] = {"windows": windows} | tables.get("correlation", {})
    tables["output"] = tables.get("output", {}) | {"directory": "results"}
    return tomli_w.dumps(tables).rstrip("\n")
