"""The optics sheet: what a laboratory knows of its camera, as nested tables of a JSON or TOML file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from plenopiv import optics
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

CONJUGATE = 0.02  # by which stated distances may miss 1/f = 1/S_o + 1/S_i, relative


class OpticsSheet:
    """What is known of the camera: nested tables of a JSON or TOML file."""

    def __init__(self, path: Path):
        self.path = path
        try:
            text = path.read_text(encoding="utf-8")
            self.tables = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
        except FileNotFoundError:
            raise PlenoPIVError(f"{path}: no such file; plenopiv init --help shows an optics sheet") from None
        except OSError as error:
            raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError as error:  # JSON, TOML and UTF-8 errors alike
            raise PlenoPIVError(f"{path}: is neither valid JSON nor TOML: {' '.join(str(error).split())}") from None
        if not isinstance(self.tables, dict):
            raise PlenoPIVError(f"{path}: must hold tables main_lens, microlens_array, sensor and recording")

    def value(self, table: str, *names: str) -> Any:
        """The first of these keys that the table has, or None."""
        section = self.tables.get(table)
        if not isinstance(section, dict):
            return None
        return next((section[name] for name in names if name in section), None)

    def number(self, table: str, *names: str) -> float:
        """A number under one of these keys; an error that names the key where there is none."""
        found = self.value(table, *names)
        if isinstance(found, bool) or not isinstance(found, int | float):
            problem = "is missing" if found is None else f"= {found!r} is no number"
            raise PlenoPIVError(f"{self.path}: {table}.{names[0]} {problem}")
        return found

    def text(self, table: str, name: str, allowed: tuple[str, ...]) -> Any:
        """A word of a choice."""
        found = self.value(table, name)
        if found not in allowed:
            problem = "is missing" if found is None else f"= {found!r} is wrong"
            raise PlenoPIVError(f"{self.path}: {table}.{name} {problem}; give {' or '.join(allowed)}")
        return found

    def camera(self, columns: int, rows: int) -> PlenopticCamera:
        """The camera, for images of this size."""
        stated = (self.value("sensor", "columns") or columns, self.value("sensor", "rows") or rows)
        if stated != (columns, rows):
            raise PlenoPIVError(
                f"{self.path}: sensor is {stated[0]} x {stated[1]} pixels, but the images are {columns} x {rows}"
            )
        focal = self.number("main_lens", "focal_length_mm")
        m = self._magnification(focal)
        if self.value("main_lens", "aperture_mm") is not None:
            aperture = self.number("main_lens", "aperture_mm")
        else:
            aperture = focal / self.number("main_lens", "f_number")
        lengths = {
            "main_lens.focal_length_mm": focal,
            "main_lens.aperture_mm": aperture,
            "main_lens.magnification, times -1,": -m,
            "microlens_array.pitch_mm": self.number("microlens_array", "pitch_mm"),
            "microlens_array.focal_length_mm": self.number("microlens_array", "focal_length_mm"),
            "sensor.pixel_pitch_mm": self.number("sensor", "pixel_pitch_mm"),
        }
        for name, value in lengths.items():
            if not 0 < value < float("inf"):
                raise PlenoPIVError(f"{self.path}: {name} = {value:g} must be positive and finite")
        kind = self.text("microlens_array", "lattice", ("square", "hexagonal"))
        bits, black = self.number("sensor", "bits", "bit_depth"), self.value("sensor", "black_level") or 0
        sensor = Sensor(columns, rows, lengths["sensor.pixel_pitch_mm"], int(bits), black)
        lattice = Lattice(kind, lengths["microlens_array.pitch_mm"])
        return PlenopticCamera(
            MainLens(focal, aperture, m), lattice, lengths["microlens_array.focal_length_mm"], sensor
        )

    def _magnification(self, focal_mm: float) -> float:
        """M as stated, or from the distances; these must be conjugates of the focal length."""
        stated = self.value("main_lens", "magnification")
        near, far = (self.value("main_lens", f"{side}_distance_mm") for side in ("object", "image"))
        if stated is not None and (near is None or far is None):
            return self.number("main_lens", "magnification")
        s_o, s_i = (self.number("main_lens", f"{side}_distance_mm") for side in ("object", "image"))
        m = -s_i / s_o if stated is None else self.number("main_lens", "magnification")
        if focal_mm > 0 and s_o > 0 and s_i > 0 and m < 0:
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
        try:
            lo, hi = (float(z) for z in depth)
        except (TypeError, ValueError):
            raise PlenoPIVError(f"{self.path}: seeding.depth_mm = {depth!r} must be two numbers [low, high]") from None
        return lo, hi
