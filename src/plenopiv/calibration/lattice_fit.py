"""A calibrated microlens lattice, how well it fits, and the small TOML file that keeps both."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from plenopiv.cameras.plenoptic import LensRim
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeMap, powers

DEVIATIONS = ("rotation_std_rad", "stretch_std", "shear_std_rad")  # older files lack them
LARGEST_DEGREE = 9  # of a map that a file may hold


@dataclass(frozen=True)
class LatticeFit:
    """The lattice of the microlenses and how well it fits. Residuals are measured minus fitted micro-image centres.

    ``lattice`` is that of the microlenses, in mm on the microlens plane; their images are ``image_pitch_px`` apart.
    ``residual_px`` is the RMS and ``worst_px`` the 99.9th percentile of the residuals' lengths, shot noise included.
    ``residual_map_px[row][column]`` is the length of the mean residual in blocks of the upright image (NaN where no
    micro-image was measured): noise averages out in it, what the lattice does not describe stays. ``stretch`` and
    ``shear_rad``: by how much, relatively, the spacing along the rows exceeds that across them, and by how much the
    angle between the two falls short of a right angle. Both are zero for a regular array parallel to the sensor; where
    the array departs from it by more than chance, ``lattice.map`` holds them and what else the array is distorted by.
    ``rim``: the main lens' rim, where it clips micro-images; None where it does not. ``microlenses`` were used,
    ``rejected`` were not (dust, dead, dark). Standard deviations are 0 where not known.
    """

    lattice: Lattice
    image_pitch_px: float
    residual_px: float
    worst_px: float
    residual_map_px: tuple[tuple[float, ...], ...]
    stretch: float
    shear_rad: float
    microlenses: int
    rejected: int
    rotation_std_rad: float = 0.0
    stretch_std: float = 0.0
    shear_std_rad: float = 0.0
    rim: LensRim | None = None

    def __repr__(self) -> str:
        return (
            f"<LatticeFit {self.lattice!r}, micro-images {self.image_pitch_px:.5g} px apart, residual"
            f" {self.residual_px:.2g} px RMS, {self.microlenses} microlenses used, {self.rejected} not>"
        )

    @property
    def rotation_deg(self) -> float:
        """Rotation of the rows from s, counter-clockwise in (s, t): in (-30, 30] if hexagonal, (-45, 45] if square."""
        return degrees(self.lattice.rotation_rad)

    @property
    def offset_mm(self) -> tuple[float, float]:
        """Centre (s, t) on the microlens plane of the lens nearest to the optical axis."""
        s, t = self.lattice.centres(0, 0)
        return float(s), float(t)

    @property
    def map_words(self) -> str:
        """What ``lattice.map`` is, in words."""
        by = self.lattice.map
        return "regular" if by is None else ("affine map", "quadratic map", "cubic map")[by.degree - 1]

    @property
    def worst_region_px(self) -> float:
        """The largest mean residual of a region."""
        return float(np.nanmax(self.residual_map_px))


def save_lattice(fit: LatticeFit, path: str | Path) -> None:
    """Write a fit as TOML. The file is written aside and renamed: it is whole or not there.

    Raises ``PlenoPIVError`` where the file cannot be written.
    """
    path, lattice = Path(path), fit.lattice
    blocks = ",\n".join("    [" + ", ".join(repr(x) for x in row) + "]" for row in fit.residual_map_px)
    text = f"""\
# Microlens lattice from a white image.
# (s, t) on the microlens plane, origin on the optical axis: in an upright image columns grow with -s, rows with +t.

[lattice]
kind = "{lattice.kind}"
pitch_mm = {lattice.pitch_mm!r}
rotation_rad = {lattice.rotation_rad!r}  # {fit.rotation_deg:.6f} degrees, counter-clockwise in (s, t)
offset_mm = [{lattice.offset_mm[0]!r}, {lattice.offset_mm[1]!r}]  # lens nearest to the axis
{_map_text(lattice.map)}{_rim_text(fit.rim)}
[fit]
image_pitch_px = {fit.image_pitch_px!r}
residual_px = {fit.residual_px!r}  # RMS
worst_px = {fit.worst_px!r}  # 99.9th percentile
stretch = {fit.stretch!r}
shear_rad = {fit.shear_rad!r}
microlenses = {fit.microlenses}
rejected = {fit.rejected}
rotation_std_rad = {fit.rotation_std_rad!r}
stretch_std = {fit.stretch_std!r}
shear_std_rad = {fit.shear_std_rad!r}
residual_map_px = [  # mean residual by regions of the upright image
{blocks},
]
"""
    aside = path.with_name(path.name + ".part")
    try:
        aside.write_text(text, encoding="utf-8")
        os.replace(aside, path)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


def _map_text(by: LatticeMap | None) -> str:
    """The section of a map; nothing for a regular lattice."""
    if by is None:
        return ""
    terms = ",\n".join(f"    [{a!r}, {b!r}]" for a, b in by.coefficients_mm)
    return f"""
[lattice.map]  # the array's departure from the regular lattice above: (ds, dt) = sum of coefficients (s, t)^(p, q)
degree = {by.degree}
unit_mm = {by.unit_mm!r}  # of s and t
coefficients_mm = [  # of s, t, s^2, s t, t^2, s^3, ...
{terms},
]
"""


def _rim_text(rim: LensRim | None) -> str:
    """The section of a rim; nothing without one."""
    if rim is None:
        return ""
    return f"""
[rim]  # of the main lens, as the microlens at S sees it on the main lens: a disc about slip S + start
radius_mm = {rim.radius_mm!r}
slip = {rim.slip!r}
start_mm = [{rim.start_mm[0]!r}, {rim.start_mm[1]!r}]
"""


def load_lattice(path: str | Path) -> LatticeFit:
    """Read what ``save_lattice`` wrote.

    Raises ``PlenoPIVError`` where the file is missing, is no TOML, or lacks a key or holds a senseless value.
    """
    way_out = "make it anew with: plenopiv calibrate"
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror}): {way_out}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlenoPIVError(f"{path}: is no lattice file ({error}): {way_out}") from error

    def fail(key: str) -> PlenoPIVError:
        return PlenoPIVError(f"{path}: {key} is missing or senseless in this lattice file: {way_out}")

    def number(section: str, key: str, low: float = -float("inf")) -> float:
        value = _table(data, section).get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value) or value < low:
            raise fail(f"{section}.{key}")
        return value

    kind: Any = _table(data, "lattice").get("kind")
    offset: Any = _table(data, "lattice").get("offset_mm")
    if kind not in ("square", "hexagonal"):
        raise fail("lattice.kind")
    if not _is_numbers(offset) or len(offset) != 2 or not all(isfinite(x) for x in offset):
        raise fail("lattice.offset_mm")
    rows = _table(data, "fit").get("residual_map_px")
    if not isinstance(rows, list) or not rows or not all(_is_numbers(row) and len(row) == len(rows[0]) for row in rows):
        raise fail("fit.residual_map_px")
    smallest = 1e-6  # of a pitch
    return LatticeFit(
        lattice=Lattice(
            kind,
            number("lattice", "pitch_mm", smallest),
            number("lattice", "rotation_rad"),
            (float(offset[0]), float(offset[1])),
            _map(_table(data, "lattice").get("map"), fail),
        ),
        image_pitch_px=number("fit", "image_pitch_px", smallest),
        residual_px=number("fit", "residual_px", 0.0),
        worst_px=number("fit", "worst_px", 0.0),
        residual_map_px=tuple(tuple(float(x) for x in row) for row in rows),
        stretch=number("fit", "stretch"),
        shear_rad=number("fit", "shear_rad"),
        microlenses=int(number("fit", "microlenses", 1)),
        rejected=int(number("fit", "rejected", 0)),
        **{key: number("fit", key, 0.0) for key in DEVIATIONS if key in _table(data, "fit")},
        rim=_rim(data, number, fail) if "rim" in data else None,
    )


def _rim(data: dict[str, Any], number: Callable[..., float], fail: Callable[[str], PlenoPIVError]) -> LensRim:
    """The rim of ``[rim]``. ``number`` reads one key, ``fail`` makes the error that names one."""
    start: Any = _table(data, "rim").get("start_mm")
    if not _is_numbers(start) or len(start) != 2 or not all(isfinite(x) for x in start):
        raise fail("rim.start_mm")
    return LensRim(number("rim", "radius_mm", 0.0), number("rim", "slip"), (float(start[0]), float(start[1])))


def _map(data: Any, fail: Callable[[str], PlenoPIVError]) -> LatticeMap | None:
    """The map of ``[lattice.map]``; None where the file has none. ``fail`` makes the error that names a key."""
    if data is None:
        return None
    table: dict[str, Any] = data if isinstance(data, dict) else {}
    degree: Any = table.get("degree")
    unit: Any = table.get("unit_mm")
    terms: Any = table.get("coefficients_mm")
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= LARGEST_DEGREE:
        raise fail("lattice.map.degree")
    if not _is_numbers([unit]) or not isfinite(unit) or unit <= 0.0:
        raise fail("lattice.map.unit_mm")
    if not isinstance(terms, list) or len(terms) != len(powers(degree)):
        raise fail("lattice.map.coefficients_mm")
    if not all(_is_numbers(term) and len(term) == 2 and all(isfinite(x) for x in term) for term in terms):
        raise fail("lattice.map.coefficients_mm")
    return LatticeMap(degree, float(unit), tuple((float(a), float(b)) for a, b in terms))


def _table(data: dict[str, Any], section: str) -> dict[str, Any]:
    """A section of the file; an empty one where it is missing."""
    table = data.get(section)
    return table if isinstance(table, dict) else {}


def _is_numbers(value: Any) -> bool:
    """Whether a value is a list of numbers, with at least one."""
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    )
