"""``plenopiv init``: draft an experiment file from a folder of images and an optics sheet."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cli.optics_sheet import OpticsSheet
from plenopiv.cli.template import filled
from plenopiv.design.advice import suggested
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.recording import image_size, natural_order

FILE = "experiment.toml"
WHITE_NAMES = ("white", "calib", "flat")
TIFF = (".tif", ".tiff")


def init(folder: Path, sheet: Path, overwrite: bool) -> str:
    """Write ``folder/experiment.toml``; returns the files used and the next commands.

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
    Experiment.from_dict(tomllib.loads(text), target)  # raises now if the draft does not load
    aside = target.with_name(f".{FILE}.part")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(target)
    finally:
        aside.unlink(missing_ok=True)
    return "\n".join(
        [
            f"{target}: drafted for {white.name} and {len(frames)} frames, {frames[0].name} to {frames[-1].name}",
            "Read it through, then in this order:",
            f"  plenopiv info {target}   # what to expect of this camera",
            f"  plenopiv check {target}  # is the recording good, and does it agree with the file?",
            f"  plenopiv run {target}    # writes {target.parent / 'results'}",
        ]
    )


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


def draft(known: OpticsSheet, camera: PlenopticCamera, white: str, frames: list[str]) -> str:
    """The text of the experiment file."""
    depth = known.depth_mm()
    why_depth = (
        "where this camera resolves depth well; set it to what is lit"
        if depth is None
        else "the seeded depth of the optics sheet"
    )
    try:
        measured = suggested(camera, depth)
    except PlenoPIVError as error:
        raise PlenoPIVError(f"{known.path}: seeding.depth_mm = {error}") from None
    x, y, z = measured.limits_mm
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
        x=list(x),
        y=list(y),
        z=list(z),
        why_depth=why_depth,
        voxel=list(measured.voxel_mm),
        windows=[list(window) for window in measured.windows],
        inner=list(CorrelationSettings(measured.windows).passes[-1].window),
        overlap=CorrelationSettings.overlap,
        method=json.dumps(ReconstructionSettings.method),
        iterations=ReconstructionSettings.iterations,
        relaxation=ReconstructionSettings.relaxation,
    )
