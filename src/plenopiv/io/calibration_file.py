"""calibration.toml: a camera calibrated with a target, and of which inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

from plenopiv.calibration.target.calibrated import PlaneResidual, TargetCalibration
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import LensRim, MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVError, brief
from plenopiv.experiment import text
from plenopiv.io.aside import written_aside
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor

HEADER = """\
# A plenoptic camera calibrated with a target: made by plenopiv calibrate, read by plenopiv run while its inputs stay.
# [parameters]: what the dots and the data sheet say together, each with its standard deviation.
# [[planes]]: RMS and mean in um, along x, y, z, by which dots lie off that had no part in the fit.
# field_um: RMS by blocks of the field, rows from +y down. views_um: [m, n, s, t] of each view, its pixel offset and the
# mean shift of all dots in it on the microlens plane. [self_calibration]: how far rays fall beside all that, as
# particles show it: made by plenopiv selfcalibrate, polynomials of places on main lens and microlens plane.

"""
NO_NUMBERS = {"kind", "alignment", "image", "medium", "map"}
WAY_OUT = "make it anew with: plenopiv calibrate --overwrite"


def save_calibration(calibration: TargetCalibration, inputs: Mapping[str, str], path: str | Path) -> None:
    """Write a calibration and what it was made of. The file is written aside and renamed: it is whole or not there.

    Raises:
        PlenoPIVError: the file cannot be written.
    """
    import tomli_w

    names = calibration.values
    document = {
        "inputs": dict(inputs),
        "parameters": {name: {"value": names[name], "std": calibration.std[name]} for name in names},
        "planes": [asdict(plane) for plane in calibration.planes],
        "residuals": {"field_um": calibration.field_um, "views_um": calibration.views_um},
        "camera": {k: v for k, v in _without_none(asdict(calibration.camera)).items() if k != "blur_mm"},
        "rays": asdict(calibration.model),
        **({} if calibration.beside is None else {"self_calibration": asdict(calibration.beside)}),
    }
    with written_aside(path) as aside:
        aside.write_text(HEADER + tomli_w.dumps(document), encoding="utf-8")


def load_calibration(path: str | Path) -> tuple[TargetCalibration, dict[str, str]]:
    """Read what ``save_calibration`` wrote, and of what inputs it was made.

    Raises:
        PlenoPIVError: the file is missing, is no TOML, or lacks a key or holds a senseless value.
    """
    path = Path(path)
    try:
        data = text.tables(path.read_bytes(), path)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror}): {WAY_OUT}") from error
    except PlenoPIVError as error:
        raise PlenoPIVError(f"{error}: {WAY_OUT}") from error
    try:
        return _calibration(data), {str(k): str(v) for k, v in data["inputs"].items()}
    except KeyError as error:
        raise PlenoPIVError(f"{path}: is damaged: {error} is missing: {WAY_OUT}") from error
    except (TypeError, ValueError, AttributeError, PlenoPIVError) as error:
        raise PlenoPIVError(f"{path}: is damaged ({brief(error)}): {WAY_OUT}") from error


def _calibration(data: Mapping[str, Any]) -> TargetCalibration:
    camera, rays, found = data["camera"], data["rays"], data["parameters"]
    moved = camera["lattice"].get("map")
    lattice = {k: v for k, v in camera["lattice"].items() if k != "map"} | {"map": None}
    rim = camera.get("rim")
    whole = PlenopticCamera(
        _exactly(MainLens, camera["main_lens"]),
        replace(_exactly(Lattice, lattice), map=None if moved is None else _exactly(LatticeMap, moved)),
        _number(camera["microlens_focal_length_mm"]),
        _exactly(Sensor, camera["sensor"]),
        None if rim is None else _exactly(LensRim, rim),
    )
    blocks, views = data["residuals"]["field_um"], data["residuals"]["views_um"]
    field = tuple(tuple(_three(block) for block in row) for row in blocks)
    return TargetCalibration(
        whole,
        _exactly(RayModel, {**rays, "medium": _exactly(Medium, rays["medium"])}),
        {name: _number(found[name]["value"]) for name in found},
        {name: _number(found[name]["std"]) for name in found},
        tuple(_exactly(PlaneResidual, plane, finite=False) for plane in data["planes"]),
        field,
        tuple((int(m), int(n), _number(s), _number(t)) for m, n, s, t in views),
        _exactly(ViewShift, data["self_calibration"]) if "self_calibration" in data else None,
    )


def _exactly(kind: type[Any], table: Mapping[str, Any], finite: bool = True) -> Any:
    """A dataclass whose every field, and nothing else, ``table`` holds; lists become tuples."""
    names = {field.name for field in fields(kind)}
    if missing := names - set(table):
        raise KeyError(sorted(missing)[0])
    if strange := set(table) - names:
        raise ValueError(f"{sorted(strange)[0]} is no key of it")
    return kind(**{name: table[name] if name in NO_NUMBERS else _tuples(table[name], finite) for name in names})


def _tuples(value: Any, finite: bool) -> Any:
    if isinstance(value, list):
        return tuple(_tuples(each, finite) for each in value)
    if isinstance(value, bool) or (finite and not isfinite(value)):
        raise ValueError(f"{value} is no number")
    return value + 0


def _number(value: Any) -> float:
    """A finite number, or ValueError."""
    if not isfinite(value):
        raise ValueError(f"{value} is no number")
    return float(value)


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)


def _without_none(value: Any) -> Any:
    """The same without keys that are None, which TOML does not have."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return value
