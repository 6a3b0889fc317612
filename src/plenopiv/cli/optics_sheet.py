"""The optics sheet: what a laboratory knows of its camera, as nested tables of a JSON or TOML file."""

from __future__ import annotations

from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any

from plenopiv import optics
from plenopiv.cameras.consistency import contradictions
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.experiment import text
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

TABLES = ("main_lens", "microlens_array", "sensor", "recording", "seeding")
SMALLEST, LARGEST = 1e-9, 1e9  # of all numbers, as in the experiment file
OPTIONAL = {  # keys that may be missing, so that a misspelled one would be taken for none
    "main_lens": ("aperture_mm", "f_number", "object_distance_mm", "image_distance_mm", "magnification"),
    "sensor": ("columns", "rows", "black_level"),
    "seeding": ("depth_mm",),
}
CONJUGATE = 0.02  # by which stated distances may miss 1/f = 1/S_o + 1/S_i, relative
STATED_TWICE = 0.05  # by which an aperture and an f-number may differ, as f-numbers are rounded (f/1.4)


class OpticsSheet:
    """What is known of the camera: nested tables of a JSON or TOML file."""

    def __init__(self, path: Path):
        self.path = path
        try:
            with path.open("rb") as file:
                content = file.read(text.LARGEST + 1)
        except FileNotFoundError:
            raise PlenoPIVError(f"{path}: no such file; plenopiv init --help shows an optics sheet") from None
        except OSError as error:
            raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
        self.tables = text.tables(content, path, as_json=path.suffix.lower() != ".toml")
        self._check_names()
        for table, keys in OPTIONAL.items():
            self._check_spelling(table, keys)

    def _check_names(self) -> None:
        """Raise PlenoPIVError for a table whose name is nearly that of a missing one; others are the user's own."""
        left = [name for name in TABLES if name not in self.tables]
        for table in self.tables:
            if table not in TABLES and (meant := get_close_matches(str(table), left, n=1, cutoff=0.8)):
                raise PlenoPIVError(f"{self.path}: {printable(str(table))}: unknown table; did you mean {meant[0]}?")

    def _check_spelling(self, table: str, optional: tuple[str, ...]) -> None:
        section = self.tables.get(table, {})
        if not isinstance(section, dict):
            raise PlenoPIVError(f"{self.path}: {table} = {_short(section)} is no table of keys")
        for key in section:
            left = [name for name in optional if name not in section]
            if key not in optional and (meant := get_close_matches(str(key), left, n=1, cutoff=0.8)):
                raise PlenoPIVError(f"{self.path}: {table}.{printable(key)}: unknown key; did you mean {meant[0]}?")

    def value(self, table: str, *names: str) -> Any:
        """Of these keys, which all say the same, the one that the table has, or None."""
        section = self.tables.get(table)
        if not isinstance(section, dict) or not (found := [name for name in names if name in section]):
            return None
        if any(section[name] != section[found[0]] for name in found[1:]):
            both = " and ".join(f"{table}.{name} = {_short(section[name])}" for name in found)
            raise PlenoPIVError(f"{self.path}: {both}: give one")
        return section[found[0]]

    def number(self, table: str, *names: str) -> float:
        """A number under one of these keys; an error that names the key where there is none."""
        found = self.value(table, *names)
        if isinstance(found, bool) or not isinstance(found, int | float):
            problem = (
                f"is missing{self._meant(table, names[0])}" if found is None else f"= {_short(found)} is no number"
            )
            raise PlenoPIVError(f"{self.path}: {table}.{names[0]} {problem}")
        if not isfinite(found) or (found and not SMALLEST <= abs(found) <= LARGEST):
            raise PlenoPIVError(
                f"{self.path}: {table}.{names[0]} = {found:g} is not between {SMALLEST:g} and {LARGEST:g}; is its unit "
                "that of the key's name?"
            )
        return float(found)

    def _meant(self, table: str, name: str) -> str:
        """Which key of the table was meant by ``name``: one with another unit, or with none."""
        section, stem = self.tables.get(table), name.rpartition("_")[0]
        keys = map(str, section) if stem and isinstance(section, dict) else ()
        near = next((key for key in keys if stem in (key, key.rpartition("_")[0])), None)
        return f"; {table}.{printable(near)} is no key, units are in the names of keys" if near else ""

    def _positive(self, table: str, name: str) -> float:
        found = self.number(table, name)
        if not found > 0:
            raise PlenoPIVError(f"{self.path}: {table}.{name} = {found:g} must be positive and finite")
        return found

    def whole(self, table: str, *names: str, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high`` under one of these keys."""
        found = self.number(table, *names)
        if found != int(found) or not low <= found <= high:
            raise PlenoPIVError(
                f"{self.path}: {table}.{names[0]} = {found:g} must be a whole number from {low} to {high}"
            )
        return int(found)

    def text(self, table: str, name: str, allowed: tuple[str, ...]) -> Any:
        """A word of a choice."""
        found = self.value(table, name)
        if not isinstance(found, str) or found not in allowed:
            problem = "is missing" if found is None else f"= {_short(found)} is wrong"
            raise PlenoPIVError(f"{self.path}: {table}.{name} {problem}; give {' or '.join(allowed)}")
        return found

    def camera(self, columns: int, rows: int) -> PlenopticCamera:
        """The camera, for images of this size."""
        images = {"columns": columns, "rows": rows}
        stated = tuple(
            n if self.value("sensor", side) is None else self.whole("sensor", side, low=16, high=65536)
            for side, n in images.items()
        )
        if stated != (columns, rows):
            raise PlenoPIVError(
                f"{self.path}: sensor is {stated[0]} x {stated[1]} pixels, but the images are {columns} x {rows}"
            )
        focal = self.number("main_lens", "focal_length_mm")
        m = self._magnification(focal)
        aperture = self._aperture(focal)
        lengths = {
            "main_lens.focal_length_mm": focal,
            "main_lens.aperture_mm": aperture,
            "microlens_array.pitch_mm": self.number("microlens_array", "pitch_mm"),
            "microlens_array.focal_length_mm": self.number("microlens_array", "focal_length_mm"),
            "sensor.pixel_pitch_mm": self.number("sensor", "pixel_pitch_mm"),
        }
        for name, value in lengths.items():
            if not value > 0:
                raise PlenoPIVError(f"{self.path}: {name} = {value:g} must be positive and finite")
        if not m < 0:
            raise PlenoPIVError(
                f"{self.path}: main_lens.magnification = {m:g} must be negative, because a real image is inverted"
            )
        kind = self.text("microlens_array", "lattice", ("square", "hexagonal"))
        bits = self.whole("sensor", "bits", "bit_depth", low=8, high=16)
        black = 0.0 if self.value("sensor", "black_level") is None else self.number("sensor", "black_level")
        if not 0 <= black < 2**bits - 1:
            raise PlenoPIVError(f"{self.path}: sensor.black_level = {black:g} must be from 0 to below 2^{bits} - 1")
        sensor = Sensor(columns, rows, lengths["sensor.pixel_pitch_mm"], bits, black)
        lattice = Lattice(kind, lengths["microlens_array.pitch_mm"])
        camera = PlenopticCamera(
            MainLens(focal, aperture, m), lattice, lengths["microlens_array.focal_length_mm"], sensor
        )
        if wrong := contradictions(camera):
            raise PlenoPIVError(f"{self.path}: {wrong[0]}")
        return camera

    def _aperture(self, focal_mm: float) -> float:
        """As stated, or from the f-number; where there are both they must agree."""
        if self.value("main_lens", "aperture_mm") is None:
            return focal_mm / self._positive("main_lens", "f_number")
        stated = self.number("main_lens", "aperture_mm")
        if self.value("main_lens", "f_number") is not None:
            number = self._positive("main_lens", "f_number")
            if abs(focal_mm / number - stated) > STATED_TWICE * abs(stated):
                raise PlenoPIVError(
                    f"{self.path}: main_lens.f_number = {number:g} is an aperture of {focal_mm / number:.4g} mm, but "
                    f"main_lens.aperture_mm = {stated:g}: give one"
                )
        return stated

    def _magnification(self, focal_mm: float) -> float:
        """M as stated, or from the distances; these must be conjugates of the focal length."""
        stated = self.value("main_lens", "magnification")
        near, far = (self.value("main_lens", f"{side}_distance_mm") for side in ("object", "image"))
        if stated is not None and (near is None or far is None):
            return self.number("main_lens", "magnification")
        s_o, s_i = (self._positive("main_lens", f"{side}_distance_mm") for side in ("object", "image"))
        m = -s_i / s_o if stated is None else self.number("main_lens", "magnification")
        if focal_mm > 0 and m < 0:
            wanted = optics.conjugate_distances(focal_mm, m)
            if max(abs(s_o / wanted[0] - 1), abs(s_i / wanted[1] - 1)) > CONJUGATE:
                raise PlenoPIVError(
                    f"{self.path}: main_lens.focal_length_mm = {focal_mm:g} does not image {s_o:g} mm to {s_i:g} mm at "
                    f"M = {m:.3g}: a thin lens needs {wanted[0]:.4g} and {wanted[1]:.4g} mm"
                )
        return m

    def depth_mm(self) -> tuple[float, float] | None:
        """The seeded depth, where the sheet states one."""
        depth = self.value("seeding", "depth_mm")
        if depth is None:
            return None
        numbers = isinstance(depth, list) and all(isinstance(z, int | float) and abs(z) <= LARGEST for z in depth)
        if not numbers or len(depth) != 2:
            raise PlenoPIVError(
                f"{self.path}: seeding.depth_mm = {_short(depth)} must be two numbers [low, high] in mm"
            )
        return float(depth[0]), float(depth[1])


def _short(value: Any) -> str:
    written = repr(value)
    return written if len(written) <= 60 else f"{written[:57]}..."
