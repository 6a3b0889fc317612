"""``plenopiv export``: a velocity field, or a kept volume, as other programs read it."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError
from plenopiv.io import read_velocity
from plenopiv.io.openpiv import write_openpiv
from plenopiv.io.volumes import volume_in_laboratory
from plenopiv.io.vtkhdf import write_volume_vtkhdf, write_vtkhdf

VTKHDF, OPENPIV, VOLUME = ".vtkhdf", ".txt", ".h5"


def export(source: Path, target: Path, z_mm: float | None, time: int, overwrite: bool) -> Outcome:
    """Write ``target``, in the format that its ending names, of a velocity field or a kept volume (.h5).

    Raises:
        PlenoPIVError: the source cannot be read; an ending that is no format, a plane that is missing or not asked for;
            ``target`` is there already.
    """
    kind = target.suffix.lower()
    if kind not in (VTKHDF, OPENPIV):
        raise PlenoPIVError(f"{target}: the ending names the format: {VTKHDF} for ParaView, {OPENPIV} for OpenPIV")
    if kind == OPENPIV and source.suffix.lower() == VOLUME:
        raise PlenoPIVError(f"{target}: OpenPIV's files hold vectors, {source.name} a volume; name a {VTKHDF} file")
    if (kind == OPENPIV) != (z_mm is not None):
        needs = "OpenPIV's files hold one plane: choose it with --z" if z_mm is None else f"{VTKHDF} holds all planes"
        raise PlenoPIVError(f"{target}: {needs}" + ("" if z_mm is None else "; leave --z out"))
    if target.exists() and not overwrite:
        raise PlenoPIVError(f"{target}: is there already; use --overwrite, or another name")
    if source.suffix.lower() == VOLUME:
        write_volume_vtkhdf(target, volume_in_laboratory(source))
        return Outcome(str(target), {"file": str(target)})
    dataset = read_velocity(source)
    if z_mm is None:
        write_vtkhdf(target, dataset)
    else:
        write_openpiv(target, dataset, z_mm, time)
    return Outcome(str(target), {"file": str(target)})
