"""A calibrated camera as tables of TOML or JSON, and back to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from math import isfinite
from typing import Any

from plenopiv.cameras.plenoptic import LensRim, MainLens, PlenopticCamera
from plenopiv.io.output import plain
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor

WORDS = {"kind", "alignment", "image", "medium", "map"}  # fields that are no numbers


def tables_of(camera: PlenopticCamera) -> dict[str, Any]:
    """All that a camera holds, tuples as lists; what is None is left out."""
    tables: dict[str, Any] = plain(without_none(asdict(camera)))
    return tables


def camera_of(tables: Mapping[str, Any]) -> PlenopticCamera:
    """The camera that ``tables_of`` made them of; without "blur_mm" that of a sharp lens.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: a key is missing, strange, or holds no number or table.
        PlenoPIVError: no camera has its value.
    """
    moved, rim = tables["lattice"].get("map"), tables.get("rim")
    lattice = {k: v for k, v in tables["lattice"].items() if k != "map"} | {"map": None}
    return PlenopticCamera(
        from_table(MainLens, tables["main_lens"]),
        replace(from_table(Lattice, lattice), map=None if moved is None else from_table(LatticeMap, moved)),
        number(tables["microlens_focal_length_mm"]),
        from_table(Sensor, tables["sensor"]),
        None if rim is None else from_table(LensRim, rim),
        number(tables.get("blur_mm", 0.0)),
    )


def from_table(kind: type[Any], table: Mapping[str, Any], finite: bool = True) -> Any:
    """A dataclass whose every field, and nothing else, ``table`` holds; lists become tuples.

    Raises:
        KeyError, TypeError, ValueError: as ``camera_of``.
    """
    names = {field.name for field in fields(kind)}
    if missing := names - set(table):
        raise KeyError(sorted(missing)[0])
    if strange := set(table) - names:
        raise ValueError(f"{sorted(strange)[0]} is no key of it")
    return kind(**{name: table[name] if name in WORDS else _tuples(table[name], finite) for name in names})


def number(value: Any) -> float:
    """A finite number, or TypeError or ValueError."""
    if not isfinite(value):
        raise ValueError(f"{value} is no number")
    return float(value)


def without_none(value: Any) -> Any:
    """The same without keys that are None, which TOML does not have."""
    if isinstance(value, dict):
        return {k: without_none(v) for k, v in value.items() if v is not None}
    return value


def _tuples(value: Any, finite: bool) -> Any:
    if isinstance(value, list):
        return tuple(_tuples(each, finite) for each in value)
    if not isinstance(value, int | float):
        raise TypeError(f"{value} is no number")
    if isinstance(value, bool) or (finite and not isfinite(value)):
        raise ValueError(f"{value} is no number")
    return value
