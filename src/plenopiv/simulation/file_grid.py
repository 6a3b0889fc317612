"""Velocities on the regular grid of a file, in the file's own units, and their conversion to mm and m/s."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.gridded import GriddedVelocity, Outside

Vector = tuple[float, float, float]
# How files write units, without blanks, in mm and m/s.
LENGTHS = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "meter": 1e3, "metre": 1e3}
LENGTHS |= {"um": 1e-3, "µm": 1e-3, "micrometer": 1e-3, "micron": 1e-3}
SPEEDS = {"m/s": 1.0, "ms-1": 1.0, "ms^-1": 1.0, "mm/s": 1e-3, "mms-1": 1e-3, "mms^-1": 1e-3}
SPEEDS |= {"cm/s": 1e-2, "cms-1": 1e-2, "cms^-1": 1e-2}


@dataclass(frozen=True, eq=False)
class FileGrid:
    """What a file holds, in its own units.

    ``velocity``: (z, y, x, 3). ``first`` and ``spacing`` along x, y, z. ``length_unit`` and ``velocity_unit``: what the
    file states for (x, y, z) and (u, v, w), None where it does not.
    """

    path: Path
    velocity: NDArray
    first: Vector
    spacing: Vector
    length_unit: tuple[str | None, ...] = (None, None, None)
    velocity_unit: tuple[str | None, ...] = (None, None, None)

    def in_mm_and_m_s(
        self, length_unit: str | None = None, velocity_unit: str | None = None, outside: Outside = "error"
    ) -> GriddedVelocity:
        """The same in mm and m/s; the units given serve where the file states none."""
        mm = [_factor(self.path, "length_unit", axis, stated, length_unit, LENGTHS)
              for axis, stated in zip("xyz", self.length_unit, strict=True)]  # fmt: skip
        m_s = [_factor(self.path, "velocity_unit", name, stated, velocity_unit, SPEEDS)
               for name, stated in zip("uvw", self.velocity_unit, strict=True)]  # fmt: skip
        first, spacing = (tuple(a * b for a, b in zip(v, mm, strict=True)) for v in (self.first, self.spacing))
        return GriddedVelocity(self.velocity * m_s, first, spacing, outside, str(self.path))  # type: ignore[arg-type]


def _factor(path: Path, key: str, name: str, stated: str | None, given: str | None, known: dict[str, float]) -> float:
    """What one of the file's units is in ours."""
    if stated and given and known.get(_plain(stated)) != known.get(_plain(given)):
        raise PlenoPIVError(f"flow: {path}: {name} is in '{stated}' there, but {key} = '{given}'; leave {key} out")
    unit = stated or given
    usual = [u for u in known if "/" in u or len(u) < 3]
    if unit is None:
        raise PlenoPIVError(f"flow: {path}: states no units for {name}; give {key}, one of {', '.join(usual)}")
    if _plain(unit) not in known:
        raise PlenoPIVError(f"flow: {path}: {name} is in '{unit}', which is not known; use one of {', '.join(usual)}")
    return known[_plain(unit)]


def _plain(unit: str) -> str:
    """A unit without blanks and dots; "m s-1", "m.s**-1" and "ms^-1" are one."""
    unit = unit.replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}")
    joined = "".join(unit.replace("**", "^").replace("·", " ").replace(".", " ").split())
    return joined[:-1] if joined.endswith(("meters", "metres", "microns")) else joined


def missing_variable(name: str, there: list[str]) -> str:
    """The message for a variable that is missing."""
    close = difflib.get_close_matches(name, there, 1, 0.6)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return f"has no variable '{name}'; {hint}it holds {', '.join(there) or 'none'}; name yours with variables"
