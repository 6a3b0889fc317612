"""calibration.toml: a camera calibrated with a target, and of which inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from plenopiv.calibration.target.calibrated import PlaneResidual, TargetCalibration
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.ray_model import RayModel
from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVError, brief
from plenopiv.experiment import text
from plenopiv.io.aside import written_aside
from plenopiv.io.camera_tables import camera_of, from_table, number, tables_of

HEADER = """\
# A plenoptic camera calibrated with a target: made by plenopiv calibrate, read by plenopiv run while its inputs stay.
# [parameters]: what the dots and the data sheet say together, each with its standard deviation.
# [[planes]]: RMS and mean in um, along x, y, z, by which dots lie off that had no part in the fit.
# field_um: RMS by blocks of the field, rows from +y down. views_um: [m, n, s, t] of each view, its pixel offset and the
# mean shift of all dots in it on the microlens plane. [self_calibration]: how far rays fall beside all that, as
# particles show it: made by plenopiv selfcalibrate, polynomials of places on main lens and microlens plane.

"""
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
        "camera": {k: v for k, v in tables_of(calibration.camera).items() if k != "blur_mm"},
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
    rays, found = data["rays"], data["parameters"]
    blocks, views = data["residuals"]["field_um"], data["residuals"]["views_um"]
    field = tuple(tuple(_three(block) for block in row) for row in blocks)
    return TargetCalibration(
        camera_of(data["camera"]),
        from_table(RayModel, {**rays, "medium": from_table(Medium, rays["medium"])}),
        {name: number(found[name]["value"]) for name in found},
        {name: number(found[name]["std"]) for name in found},
        tuple(from_table(PlaneResidual, {"outliers": 0} | plane, finite=False) for plane in data["planes"]),
        field,
        tuple((int(m), int(n), number(s), number(t)) for m, n, s, t in views),
        from_table(ViewShift, data["self_calibration"]) if "self_calibration" in data else None,
    )


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
