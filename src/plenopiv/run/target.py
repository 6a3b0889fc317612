"""The calibration of an experiment's camera with its target: read where it is there, made where it is not."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from plenopiv.calibration import LatticeFit, find_lattice
from plenopiv.calibration.aperture import aperture_disc
from plenopiv.calibration.target.board import Board, TargetImage
from plenopiv.calibration.target.calibrated import TargetCalibration, calibrate_target, lens_space_camera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration, save_calibration
from plenopiv.io.manifest import sha256
from plenopiv.io.output import plain
from plenopiv.lightfield import decode, layout
from plenopiv.reconstruction.noise import counts_per_electron
from plenopiv.recording import Recording
from plenopiv.recording.sources import only_source
from plenopiv.run.inputs import with_target

FILE = "calibration.toml"
METHOD = 3  # of the fit: another number makes calibrations of before invalid
LATER = {"origin_mm", "turn_deg"}  # keys of [calibration] that take effect without a new fit

Progress = Callable[[str, int, int], None]


def target_calibration(
    experiment: Experiment, recording: Recording, fit: LatticeFit | None = None, progress: Progress | None = None
) -> TargetCalibration | None:
    """The calibration with the target of [calibration]; None without one. ``calibration.toml`` beside the experiment
    file is used as long as it is of the same images and keys, and written anew where it is not. ``fit``: of the white
    image, where it was found before.

    Raises:
        PlenoPIVError: an image cannot be used, or the dots do not determine the camera; see ``calibrate_target``.
    """
    if experiment.calibration is None:
        return None
    path, inputs = experiment.folder / FILE, inputs_of(experiment, recording)
    if path.exists():
        found, of = load_calibration(path)
        if of == inputs:
            return found
        changed = sorted(key for key in {*of, *inputs} if of.get(key) != inputs.get(key))
        lost = "" if found.beside is None else "; what plenopiv selfcalibrate added is lost: give it again"
        warnings.warn(
            f"{path}: was made of other inputs ({', '.join(changed[:3])}); it is made again{lost}",
            PlenoPIVWarning,
            stacklevel=2,
        )
    elif (elsewhere := _beside_images(experiment, inputs)) is not None:
        return elsewhere
    found = make_calibration(experiment, recording, fit, progress)
    save_calibration(found, inputs, path)
    return found


def _beside_images(experiment: Experiment, inputs: dict[str, str]) -> TargetCalibration | None:
    """A calibration of the same inputs beside the target's images, above their folder or above that of the experiment
    file: the experiment file of a results folder, which names the images where they are, needs none of its own."""
    assert experiment.calibration is not None
    images = (experiment.folder / experiment.calibration.planes[0].image).parent
    for folder in (images, images / "..", experiment.folder / ".."):
        with suppress(PlenoPIVError):
            found, of = load_calibration(folder / FILE)
            if of == inputs:
                return found
    return None


def make_calibration(
    experiment: Experiment, recording: Recording, fit: LatticeFit | None = None, progress: Progress | None = None
) -> TargetCalibration:
    """The calibration from the images of the target.

    Raises:
        PlenoPIVError: there is no white image; else as ``target_calibration``.
    """
    table, white = experiment.calibration, recording.white()
    assert table is not None
    assert table.origin_dot_mm is not None
    if white is None:
        raise PlenoPIVError(f"{experiment.path}: recording.white is missing; a calibration needs the white image")
    sheet = experiment.camera()
    fit = fit or find_lattice(white, sheet, str(recording.white_path))
    radius = aperture_disc(white, sheet.with_lattice(fit.lattice)).radius_px
    camera = lens_space_camera(sheet, fit, radius)
    dark, unusable = recording.dark_level()
    level = dark - np.float32(camera.sensor.black_level)
    images = [
        TargetImage(plane.image, plane.z_mm, recording.counts_of(experiment.folder / plane.image) - level)
        for plane in table.planes
    ]
    board = Board(table.pitch_mm, table.dot_mm, table.origin_dot_mm, table.x_dot_mm, table.step_mm)
    gain = counts_per_electron(decode(white, layout(camera)))
    medium = None if experiment.medium is None else experiment.medium.medium()
    report = partial(progress, "target") if progress else None
    if recording.masked is not None:
        unusable = unusable | recording.masked
    focal_length = sheet.main_lens.focal_length_mm
    return calibrate_target(images, board, camera, medium, gain, unusable, white, report, focal_length)


def inputs_of(experiment: Experiment, recording: Recording) -> dict[str, str]:
    """What a calibration depends on, by name: hashes of images and of the keys of the experiment file."""
    assert experiment.calibration is not None
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    planes = experiment.calibration.planes
    keys = {key: value for key, value in tables["calibration"].items() if key not in LATER}
    keys["planes"] = [plane.z_mm for plane in planes]  # wherever their images lie
    mask = recording.mask
    files = with_target(experiment, {"white": recording.white_path, "dark": recording.dark_path})
    return {
        "method": str(METHOD),
        "[camera]": _hash(tables["camera"]),
        "[calibration]": _hash(keys),
        "[medium]": _hash(tables.get("medium")),
        "recording.orientation": experiment.recording_table.orientation,
        "recording.mask": _of_file(mask) if isinstance(mask, Path) else _hash(mask),
        **{name: _of_file(path) for name, path in files.items()},
    }


def _of_file(name: Path) -> str:
    """Hash of the file that an image is in; "missing" where it cannot be read, which is told when it is used."""
    try:
        return sha256(only_source(name).path)[:16]
    except (OSError, PlenoPIVError):
        return "missing"


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(plain(value), sort_keys=True).encode()).hexdigest()[:16]
