"""``plenopiv init``: draft an experiment file from a folder of images and an optics sheet."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cli.folder import FolderImages, folder_images
from plenopiv.cli.optics_sheet import OpticsSheet
from plenopiv.cli.template import BEFORE_COMMENT, filled, toml
from plenopiv.cli.terminal import command_line
from plenopiv.design.advice import suggested
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.experiment import Experiment
from plenopiv.reconstruction.settings import ReconstructionSettings

FILE = "experiment.toml"


def init(folder: Path, sheet: Path, overwrite: bool) -> str:
    """Write ``folder/experiment.toml``; returns what the images were taken for, and the next commands.

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
    images = folder_images(folder, known.value("sensor", "rows"))
    camera = known.camera(images.columns, images.rows)
    text = draft(known, camera, images)
    Experiment.from_dict(tomllib.loads(text), sheet)  # raises now if the draft does not load: the sheet is why
    aside = target.with_name(f".{FILE}.part")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(target)
    finally:
        aside.unlink(missing_ok=True)
    steps = {
        "info": "what to expect of this camera",
        "check": "is the recording good, and does it agree with the file?",
        "run": f"writes {target.parent / 'results'}",
    }
    commands = {command_line(step, target): words for step, words in steps.items()}
    width = max(map(len, commands))
    return "\n".join(
        [
            f"{printable(str(target))}: drafted, with the images taken for",
            *(f"  {what:<10}  {words}" for what, words in images.lines),
            "Read it through, then in this order:",
            *(f"  {command:<{width}}  # {printable(words)}" for command, words in commands.items()),
        ]
    )


def draft(known: OpticsSheet, camera: PlenopticCamera, images: FolderImages) -> str:
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
        black_level=f"{sensor.black_level:g}",
        images=image_lines(images),
        dt=float(known.number("recording", "dt_s")),
        what_dt="from one frame to the next" if images.frames.pairs is None else "between the two frames of a pair",
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


def image_lines(images: FolderImages) -> str:
    """The lines of [recording] that name files; what there is not, as a comment."""
    frames = images.frames
    lines = [f"white = {toml(images.white)}{BEFORE_COMMENT}an evenly lit surface: shows where the microlenses are"]
    dark = f"dark = {toml(images.dark)}" if images.dark else '# dark = "dark.tif"'
    lines.append(f"{dark}{BEFORE_COMMENT}with the sensor covered: black level of each pixel, hot pixels")
    taken = images.background[0] if len(images.background) == 1 else images.background
    background = f"background = {toml(taken)}" if taken else '# background = "background.tif"'
    lines.append(f"{background}{BEFORE_COMMENT}light without particles; or a list of two, one for each pulse")
    if frames.pairs is not None:
        lines.append(f"pairs = {toml(frames.pairs)}{BEFORE_COMMENT}of a double-frame camera: first and second pulse")
    else:
        lines.append(f'frames = {toml(frames.frames)}{BEFORE_COMMENT}a list, or a glob such as "run7/*.tif"')
    if frames.stacked:
        lines.append(f'stacked = "top-first"{BEFORE_COMMENT}assumed')
    return "\n".join([*lines, *([f"# {frames.doubt}"] if frames.doubt else [])])
