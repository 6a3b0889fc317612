"""``plenopiv init``: draft an experiment file from a folder of images and an optics sheet."""

from __future__ import annotations

import json
import tomllib
from math import floor, log10
from pathlib import Path
from typing import Any

from plenopiv.cameras.coverage import half_sensor_mm, seen_by_every_view_mm
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cli.template import filled
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.recording import image_size, natural_order
from plenopiv.sensor import Sensor
from plenopiv.volume import VoxelGrid

FILE = "experiment.toml"
WHITE_NAMES = ("white", "calib", "flat")
TIFF = (".tif", ".tiff")
VOXEL_PX = 36.0 / 2100.0 / 0.0055  # Shi, Ding & New (2016), section 4: 36 mm / 2100 voxels, pixels of 5.5 um
USEFUL_DEPTH = 0.75  # of PMR f_l / M^2, where a view's footprint of a point outgrows a microlens
LARGEST_BLUR = 0.25  # of the sensor's half height
SMALLEST_WINDOW = 8  # voxels
LAST_WINDOW = (64, 64, 16)


def init(folder: Path, sheet: Path, overwrite: bool) -> str:
    """Write ``folder/experiment.toml`` and say what to do next.

    Raises:
        PlenoPIVError: the folder or sheet cannot be used, the sheet lacks a value, images are missing, differ in size
            or contradict the sheet, or the file is already there.
    """
    target = folder / FILE
    if not folder.is_dir():
        raise PlenoPIVError(f"{folder}: no such folder; name the folder that holds the images")
    if target.exists() and not overwrite:
        raise PlenoPIVError(f"{target}: is already there; use --overwrite to replace it")
    known = OpticsSheet(sheet)
    white, frames = images(folder)
    columns, rows = _common_size([white, *frames])
    camera = known.camera(columns, rows)
    text = draft(known, camera, white.name, [frame.name for frame in frames])
    Experiment.from_dict(tomllib.loads(text), target)  # a draft that does not load helps nobody
    aside = target.with_name(f".{FILE}.part")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(target)
    finally:
        aside.unlink(missing_ok=True)
    return f"{target}: drafted for {white.name} and {len(frames)} frames\nRead it through, then: plenopiv run {target}"


def images(folder: Path) -> tuple[Path, list[Path]]:
    """The white image, by its name, and all other TIFF files in natural order.

    Raises:
        PlenoPIVError: no white image or several, or fewer than two frames.
    """
    found = sorted((p for p in folder.iterdir() if p.suffix.lower() in TIFF), key=lambda p: natural_order(p.name))
    if not found:
        raise PlenoPIVError(f"{folder}: holds no TIFF images (.tif, .tiff); only TIFF is read")
    white = [p for p in found if p.name.lower().startswith(WHITE_NAMES)]
    frames = [p for p in found if p not in white]
    if len(white) != 1:
        names = ", ".join(p.name for p in white) or "none"
        raise PlenoPIVError(f"{folder}: needs one white image (white*, calib* or flat*.tif); found {names}")
    if len(frames) < 2:
        raise PlenoPIVError(f"{folder}: holds {len(frames)} frame beside {white[0].name}; a velocity needs two")
    return white[0], frames


def _common_size(paths: list[Path]) -> tuple[int, int]:
    first = image_size(paths[0])
    for path in paths[1:]:
        size = image_size(path)
        if size != first:
            raise PlenoPIVError(
                f"{path}: is {size[0]} x {size[1]} pixels, but {paths[0].name} is {first[0]} x {first[1]}; "
                f"all images must come from one sensor"
            )
    return first


class OpticsSheet:
    """What is known of the camera: nested tables of a JSON or TOML file."""

    def __init__(self, path: Path):
        self.path = path
        try:
            text = path.read_text(encoding="utf-8")
            self.tables = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
        except FileNotFoundError:
            raise PlenoPIVError(f"{path}: no such file; plenopiv init --help shows an optics sheet") from None
        except OSError as error:
            raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError as error:  # JSON, TOML and UTF-8 errors alike
            raise PlenoPIVError(f"{path}: is neither valid JSON nor TOML: {' '.join(str(error).split())}") from None
        if not isinstance(self.tables, dict):
            raise PlenoPIVError(f"{path}: must hold tables main_lens, microlens_array, sensor and recording")

    def value(self, table: str, *names: str) -> Any:
        """The first of these keys that the table has, or None."""
        section = self.tables.get(table)
        if not isinstance(section, dict):
            return None
        return next((section[name] for name in names if name in section), None)

    def number(self, table: str, *names: str) -> float:
        """A number under one of these keys; an error that names the key where there is none."""
        found = self.value(table, *names)
        if isinstance(found, bool) or not isinstance(found, int | float):
            said = "is missing" if found is None else f"= {found!r} is no number"
            raise PlenoPIVError(f"{self.path}: {table}.{names[0]} {said}")
        return found

    def text(self, table: str, name: str, allowed: tuple[str, ...]) -> Any:
        """A word of a choice."""
        found = self.value(table, name)
        if found not in allowed:
            said = "is missing" if found is None else f"= {found!r} is wrong"
            raise PlenoPIVError(f"{self.path}: {table}.{name} {said}; give {' or '.join(allowed)}")
        return found

    def camera(self, columns: int, rows: int) -> PlenopticCamera:
        """The camera, for images of this size."""
        stated = (self.value("sensor", "columns") or columns, self.value("sensor", "rows") or rows)
        if stated != (columns, rows):
            raise PlenoPIVError(
                f"{self.path}: sensor is {stated[0]} x {stated[1]} pixels, but the images are {columns} x {rows}"
            )
        focal = self.number("main_lens", "focal_length_mm")
        if self.value("main_lens", "magnification") is not None:
            m = self.number("main_lens", "magnification")
        else:
            m = -self.number("main_lens", "image_distance_mm") / self.number("main_lens", "object_distance_mm")
        if self.value("main_lens", "aperture_mm") is not None:
            aperture = self.number("main_lens", "aperture_mm")
        else:
            aperture = focal / self.number("main_lens", "f_number")
        lengths = {
            "main_lens.focal_length_mm": focal,
            "main_lens.aperture_mm": aperture,
            "main_lens.magnification, times -1,": -m,
            "microlens_array.pitch_mm": self.number("microlens_array", "pitch_mm"),
            "microlens_array.focal_length_mm": self.number("microlens_array", "focal_length_mm"),
            "sensor.pixel_pitch_mm": self.number("sensor", "pixel_pitch_mm"),
        }
        for name, value in lengths.items():
            if not 0 < value < float("inf"):
                raise PlenoPIVError(f"{self.path}: {name} = {value:g} must be positive and finite")
        kind = self.text("microlens_array", "lattice", ("square", "hexagonal"))
        bits, black = self.number("sensor", "bits", "bit_depth"), self.value("sensor", "black_level") or 0
        sensor = Sensor(columns, rows, lengths["sensor.pixel_pitch_mm"], int(bits), black)
        lattice = Lattice(kind, lengths["microlens_array.pitch_mm"])
        return PlenopticCamera(
            MainLens(focal, aperture, m), lattice, lengths["microlens_array.focal_length_mm"], sensor
        )


def suggested_depth_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Where one plenoptic camera resolves depth well, and all its views still see most of the field.

    Within 0.75 PMR f_l/M^2 of the focal plane, and where the blur's radius |A| P_m/2 takes at most a quarter of the
    sensor's half height W: with A = S_i z / (S_o (S_o - z)), z = k S_o/(1 + k), k = (W/4) (2/P_m) (S_o/S_i).
    """
    lens = camera.main_lens
    resolved = USEFUL_DEPTH * camera.pixels_per_microlens * camera.microlens_focal_length_mm / lens.magnification**2
    k = LARGEST_BLUR * min(half_sensor_mm(camera)) * 2 / lens.aperture_mm / abs(lens.magnification)
    reach = _down(min(resolved, k * lens.object_distance_mm / (1 + k)))
    return -reach, reach


def suggested_voxel_mm(camera: PlenopticCamera) -> tuple[float, float, float]:
    """The paper's voxels: 3.117 pixels over |M| in the plane, one microlens pitch over M^2 in depth."""
    m = abs(camera.main_lens.magnification)
    in_plane = round(VOXEL_PX * camera.sensor.pixel_pitch_mm / m, 10)
    return in_plane, in_plane, round(camera.lattice.pitch_mm / m**2, 10)


def draft(known: OpticsSheet, camera: PlenopticCamera, white: str, frames: list[str]) -> str:
    """The text of the experiment file."""
    depth = known.value("seeding", "depth_mm")
    if depth is None:
        depth, why_depth = suggested_depth_mm(camera), "where this camera resolves depth well; set it to what is lit"
    else:
        why_depth = "the seeded depth of the optics sheet"
    try:
        lo, hi = (float(z) for z in depth)
    except (TypeError, ValueError):
        raise PlenoPIVError(f"{known.path}: seeding.depth_mm = {depth!r} must be two numbers [low, high]") from None
    if not lo < hi < camera.main_lens.object_distance_mm:
        raise PlenoPIVError(f"{known.path}: seeding.depth_mm = [{lo:g}, {hi:g}] must rise and end before the main lens")
    x, y = (float(min(side)) for side in seen_by_every_view_mm(camera, [lo, hi]))
    voxel = suggested_voxel_mm(camera)
    if min(x, y) < SMALLEST_WINDOW * voxel[0]:
        seen = f"every view sees |x| < {max(x, 0):.2g}, |y| < {max(y, 0):.2g} mm from z = {lo:g} to {hi:g} mm"
        raise PlenoPIVError(f"{known.path}: seeding.depth_mm is too deep: {seen}")
    x, y = _down(x), _down(y)
    shape = VoxelGrid.covering((-x, x), (-y, y), (lo, hi), voxel).shape[::-1]
    last = [min(side, n) for side, n in zip(LAST_WINDOW, shape, strict=True)]
    first = [min(2 * side, n) for side, n in zip(LAST_WINDOW, shape, strict=True)]
    lens, sensor = camera.main_lens, camera.sensor
    return filled(
        focal_length=float(lens.focal_length_mm),
        aperture=float(lens.aperture_mm),
        magnification=float(lens.magnification),
        lattice=json.dumps(camera.lattice.kind),
        pitch=camera.lattice.pitch_mm,
        microlens_focal_length=camera.microlens_focal_length_mm,
        columns=sensor.columns,
        rows=sensor.rows,
        pixel_pitch=sensor.pixel_pitch_mm,
        bit_depth=sensor.bit_depth,
        black_level=sensor.black_level,
        white=json.dumps(white, ensure_ascii=False),
        frames=json.dumps(frames, ensure_ascii=False),
        dt=float(known.number("recording", "dt_s")),
        orientation=json.dumps(known.text("recording", "orientation", ("upright", "sensor"))),
        x=[-x, x],
        y=[-y, y],
        z=[lo, hi],
        why_depth=why_depth,
        voxel=list(voxel),
        windows=[first, last],
        overlap=CorrelationSettings.overlap,
        method=json.dumps(ReconstructionSettings.method),
        iterations=ReconstructionSettings.iterations,
        relaxation=ReconstructionSettings.relaxation,
    )


def _down(length: float) -> float:
    """Rounded down to two digits, so that a limit stays inside what it was computed from."""
    step = 10.0 ** (floor(log10(length)) - 1)
    return round(floor(length / step + 1e-9) * step, 12)
