"""``plenopiv export``: a velocity field, tracks, or a kept volume, as other programs read them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from plenopiv.cli.replacing import refuse_to_replace
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError
from plenopiv.io import read_velocity
from plenopiv.io.matlab import write_matlab
from plenopiv.io.openpiv import write_openpiv
from plenopiv.io.pivpy import write_pivpy
from plenopiv.io.series_statistics import velocity_file
from plenopiv.io.table import write_table
from plenopiv.io.tracks_file import holds_tracks, read_tracks, write_tracks_vtkhdf
from plenopiv.io.volumes import volume_in_laboratory
from plenopiv.io.vti import write_vti
from plenopiv.io.vtkhdf import write_volume_vtkhdf, write_vtkhdf

VOLUME = ".h5"


class Format(NamedTuple):
    """Who reads it, and whether it holds all planes and all times."""

    reader: str
    all_planes: bool
    all_times: bool


FORMATS = {
    ".vtkhdf": Format("ParaView", True, True),
    ".vti": Format("ParaView", True, False),
    ".csv": Format("pandas", True, True),
    ".mat": Format("MATLAB", True, True),
    ".txt": Format("OpenPIV", False, False),
    ".nc": Format("pivpy", False, True),
}


def export(source: Path, target: Path, z_mm: float | None, time: int | None, overwrite: bool) -> Outcome:
    """Write ``target``, in the format that its ending names, of a velocity field or the results folder that holds it,
    tracks, or a kept volume (.h5).

    Raises:
        PlenoPIVError: the source cannot be read; an ending that is no format, a plane or a time that is missing or not
            asked for; ``target`` is there already.
    """
    source = velocity_file(source)
    kind, of_volume = target.suffix.lower(), source.suffix.lower() == VOLUME
    if kind not in FORMATS:
        known = ", ".join(f"{ending} for {each.reader}" for ending, each in FORMATS.items())
        raise PlenoPIVError(f"{target}: the ending names the format: {known}")
    chosen = FORMATS[kind]
    if of_volume and kind != ".vtkhdf":
        holds = f"{chosen.reader}'s files hold" if not chosen.all_planes else f"{kind} files hold"
        raise PlenoPIVError(f"{target}: {holds} vectors, {source.name} a volume; name a .vtkhdf file")
    if not chosen.all_planes and z_mm is None:
        raise PlenoPIVError(f"{target}: {chosen.reader}'s files hold one plane: choose it with --z")
    if chosen.all_planes and z_mm is not None:
        raise PlenoPIVError(f"{target}: {kind} holds all planes; leave --z out")
    if chosen.all_times and time is not None:
        raise PlenoPIVError(f"{target}: {kind} holds all times; leave --time out")
    refuse_to_replace(target, (source,), overwrite)
    if of_volume:
        write_volume_vtkhdf(target, volume_in_laboratory(source))
        return Outcome(str(target), {"file": str(target)})
    if source.is_file() and holds_tracks(source):
        if kind != ".vtkhdf":
            raise PlenoPIVError(f"{target}: {kind} files hold fields, {source.name} holds tracks; name a .vtkhdf file")
        write_tracks_vtkhdf(target, read_tracks(source))
        return Outcome(str(target), {"file": str(target)})
    times = _write(kind, source, target, z_mm, time or 0)
    part = f" (time {time or 0} of {times}, counted from 0)" if times > 1 and not chosen.all_times else ""
    return Outcome(f"{target}{part}", {"file": str(target)})


def _write(kind: str, source: Path, target: Path, z_mm: float | None, time: int) -> int:
    """Write vectors; returns how many times the field has."""
    dataset = read_velocity(source)
    if kind == ".vtkhdf":
        write_vtkhdf(target, dataset)
    elif kind == ".vti":
        write_vti(target, dataset, time)
    elif kind == ".csv":
        write_table(target, dataset)
    elif kind == ".mat":
        write_matlab(target, dataset)
    elif kind == ".txt":
        assert z_mm is not None
        write_openpiv(target, dataset, z_mm, time)
    else:
        assert z_mm is not None
        write_pivpy(target, dataset, z_mm)
    return int(dataset.sizes["time"])
