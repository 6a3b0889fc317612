"""calibration.toml: a camera calibrated with a target, and of which inputs."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from plenopiv.calibration.target.calibrated import PlaneResidual, TargetCalibration
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor

HEADER = """\
# A plenoptic camera calibrated with a target: made by plenopiv calibrate, read by plenopiv run while its inputs stay.
# [parameters]: what the dots and the data sheet say together, each with its standard deviation.
# [[planes]]: RMS and mean in um, along x, y, z, by which dots lie off that had no part in the fit.
# field_um: RMS by blocks of the field, rows from +y down. views_um: [m, n, s, t] of each view, its pixel offset and the
# mean shift of all dots in it on the microlens plane.

"""
WAY_OUT = "make it anew with: plenopiv calibrate --overwrite"


def save_calibration(calibration: TargetCalibration, inputs: Mapping[str, str], path: str | Path) -> None:
    """Write a calibration and what it was made of. The file is written aside and renamed: it is whole or not there.

    Raises:
        PlenoPIVError: the file cannot be written.
    """
    import tomli_w

    path = Path(path)
    names = calibration.values
    document = {
        "inputs": dict(inputs),
        "parameters": {name: {"value": names[name], "std": calibration.std[name]} for name in names},
        "planes": [asdict(plane) for plane in calibration.planes],
        "residuals": {"field_um": calibration.field_um, "views_um": calibration.views_um},
        "camera": _without_none(asdict(calibration.camera)),
        "rays": asdict(calibration.model),
    }
    aside = path.with_name(path.name + ".part")
    try:
        with aside.open("w", encoding="utf-8") as file:
            file.write(HEADER + tomli_w.dumps(document))
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


def load_calibration(path: str | Path) -> tuple[TargetCalibration, dict[str, str]]:
    """Read what ``save_calibration`` wrote, and of what inputs it was made.

    Raises:
        PlenoPIVError: the file is missing, is no TOML, or lacks a key or holds a senseless value.
    """
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror}): {WAY_OUT}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlenoPIVError(f"{path}: is no calibration file ({error}): {WAY_OUT}") from error
    try:
        return _calibration(data), {str(k): str(v) for k, v in data["inputs"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PlenoPIVError(f"{path}: {error} is missing or senseless in this calibration: {WAY_OUT}") from error


def _calibration(data: Mapping[str, Any]) -> TargetCalibration:
    camera, rays = dict(data["camera"]), dict(data["rays"])
    lattice = dict(camera["lattice"])
    moved = lattice.pop("map", None)
    if moved is not None:
        moved = LatticeMap(**{**moved, "coefficients_mm": tuple(map(tuple, moved["coefficients_mm"]))})
    whole = PlenopticCamera(
        MainLens(**camera["main_lens"]),
        Lattice(**{**lattice, "offset_mm": tuple(lattice["offset_mm"])}, map=moved),
        float(camera["microlens_focal_length_mm"]),
        Sensor(**camera["sensor"]),
    )
    medium = dict(rays.pop("medium"))
    medium["window_tilt_deg"] = tuple(medium["window_tilt_deg"])
    rays["view_offset_mm"] = [tuple(each) for each in rays["view_offset_mm"]]
    numbers: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else float(v) for k, v in rays.items()}
    model = RayModel(**numbers, medium=Medium(**medium))
    planes = tuple(PlaneResidual(**_plane(plane)) for plane in data["planes"])
    found = data["parameters"]
    return TargetCalibration(
        whole,
        model,
        {name: float(found[name]["value"]) for name in found},
        {name: float(found[name]["std"]) for name in found},
        planes,
        tuple(tuple(tuple(block) for block in row) for row in data["residuals"]["field_um"]),
        tuple((int(m), int(n), float(s), float(t)) for m, n, s, t in data["residuals"]["views_um"]),
    )


def _plane(table: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}


def _without_none(value: Any) -> Any:
    """The same without keys that are None, which TOML does not have."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return value
