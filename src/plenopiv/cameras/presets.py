"""Cameras of the source paper (Shi, Ding & New 2016), by name.

    pmr8, pmr14, pmr28   Table 1: 448 x 448 px, 8, 14 or 28 pixels per microlens (pitch 44, 77, 154 um)
    29mp                 section 2: the 29-megapixel camera, 6600 x 4400 px, hexagonal microlenses of 77 um

All have f_m = 50 mm, M = -1 (S_o = S_i = 100 mm), f_l = 308 um, 5.5 um pixels, 12 bits.

The paper's numbers do not all agree, and these are the choices made here:

- Table 1 gives a main-lens aperture of 25 mm to every camera, but its f-numbers (3.5, 2, 1 of the main lens against 7,
  4, 2 of the microlenses at M = -1) need 14.29, 25 and 50 mm for PMR 8, 14 and 28. Matched f-numbers make the
  micro-images touch without overlap, so the matched aperture is the default; ``aperture="table"`` gives Table 1's.
- PMR 8 with its 63 microlenses needs 504 px and the sensor has 448, on which 56 fit.
- The analysis of Table 1's cameras is made for square microlenses (section 2), so theirs are square by default.
- A sensor of 6600 x 4400 px holds 471 x 362 hexagonal microlenses of 77 um, the paper counts 458 x 301.

A microlens' centre lies on the optical axis and rows along x: real lattices come from a white image.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Literal

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeKind
from plenopiv.sensor import Sensor

FOCAL_LENGTH_MM = 50.0
MAGNIFICATION = -1.0
MICROLENS_FOCAL_LENGTH_MM = 0.308
PIXEL_PITCH_MM = 0.0055
TABLE_1_APERTURE_MM = 25.0
BIT_DEPTH, BLACK_LEVEL = 12, 60


@dataclass(frozen=True)
class _Preset:
    columns: int
    rows: int
    pitch_mm: float
    lattice: LatticeKind


PRESETS = {
    "pmr8": _Preset(448, 448, 0.044, "square"),
    "pmr14": _Preset(448, 448, 0.077, "square"),
    "pmr28": _Preset(448, 448, 0.154, "square"),
    "29mp": _Preset(6600, 4400, 0.077, "hexagonal"),
}


def preset(
    name: str, *, aperture: Literal["matched", "table"] = "matched", lattice: LatticeKind | None = None
) -> PlenopticCamera:
    """A camera of the paper; see the module's text for what its numbers leave open.

    ``aperture``: "matched" f-numbers, P_m = S_i p_l / f_l, or "table", Table 1's 25 mm. ``lattice`` replaces the
    preset's kind. Raises PlenoPIVError for an unknown name, naming the nearest.
    """
    if name not in PRESETS:
        close = difflib.get_close_matches(name.lower(), PRESETS, 1, 0.0)[0]
        raise PlenoPIVError(f"camera: no preset is called '{name}', did you mean '{close}'? ({', '.join(PRESETS)})")
    if aperture not in ("matched", "table"):
        raise PlenoPIVError(f"camera: aperture '{aperture}' is unknown, give 'matched' or 'table'")
    p = PRESETS[name]
    image_distance_mm = FOCAL_LENGTH_MM * (1.0 - MAGNIFICATION)
    matched_mm = image_distance_mm * p.pitch_mm / MICROLENS_FOCAL_LENGTH_MM
    return PlenopticCamera(
        MainLens(FOCAL_LENGTH_MM, matched_mm if aperture == "matched" else TABLE_1_APERTURE_MM, MAGNIFICATION),
        Lattice(lattice or p.lattice, p.pitch_mm),
        MICROLENS_FOCAL_LENGTH_MM,
        Sensor(p.columns, p.rows, PIXEL_PITCH_MM, BIT_DEPTH, BLACK_LEVEL),
    )
