"""``plenopiv export``: a velocity field as other programs read it."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError
from plenopiv.io import read_velocity
from plenopiv.io.openpiv import write_openpiv
from plenopiv.io.vtkhdf import write_vtkhdf

VTKHDF, OPENPIV = ".vtkhdf", ".txt"


def export(velocity: Path, target: Path, z_mm: float | None, time: int, overwrite: bool) -> Outcome:
    """Write ``target``, in the format that its ending names.

    Raises:
        PlenoPIVError: the field cannot be read; an ending that is no format, a plane that is missing or not asked for;
            ``target`` is there already.
    """
    kind = target.suffix.lower()
    if kind not in (VTKHDF, OPENPIV):
        raise PlenoPIVError(f"{target}: the ending names the format: {VTKHDF} for ParaView, {OPENPIV} for OpenPIV")
    if (kind == OPENPIV) != (z_mm is not None):
        needs = "OpenPIV's files hold one plane: choose it with --z" if z_mm is None else f"{VTKHDF} holds all planes"
        raise PlenoPIVError(f"{target}: {needs}" + ("" if z_mm is None else "; leave --z out"))
    if target.exists() and not overwrite:
        raise PlenoPIVError(f"{target}: is there already; use --overwrite, or another name")
    dataset = read_velocity(velocity)
    if z_mm is None:
        write_vtkhdf(target, dataset)
    else:
        write_openpiv(target, dataset, z_mm, time)
    return Outcome(str(target), {"file": str(target)})
