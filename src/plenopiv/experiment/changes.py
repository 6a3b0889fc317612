"""Keys of an experiment, given by name in Python, put into its tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment.messages import unknown_key

Known = dict[str, list[str]]  # dotted name of a table -> its keys
LISTS = ("calibration.planes",)  # tables of which there are several: their keys are not changed by name


def change(tables: dict[str, Any], keys: Mapping[str, Any], known: Known) -> None:
    """Set ``keys`` in the nested ``tables``: by their name, which one table has alone, by their dotted name, or a
    table's keys as a mapping. None takes a key or a table out, so that its default counts.

    Raises:
        PlenoPIVError: a name that no table has, or several.
    """
    for name, value in keys.items():
        _set(tables, dotted_name(name, known), value, known)


def dotted_name(name: str, known: Known) -> str:
    """``name`` with the tables that it is in.

    Raises:
        PlenoPIVError: no table has it, or several.
    """
    table, _, key = name.rpartition(".")
    if key in known.get(table, ()):
        return name
    found = [] if table else [place for place, keys in known.items() if name in keys and place not in LISTS]
    if len(found) > 1:
        ways = " or ".join(f'{{"{place}.{name}": ...}}' for place in found)
        raise PlenoPIVError(
            f"{name}: is a key of {' and '.join(f'[{place}]' for place in found)}; write changed(**{ways})"
        )
    if not found:
        raise PlenoPIVError(unknown_key(name, known))
    return f"{found[0]}.{name}"


def _set(tables: dict[str, Any], dotted: str, value: Any, known: Known) -> None:
    if isinstance(value, Mapping) and dotted in known:
        for key, each in value.items():
            if key not in known[dotted]:
                raise PlenoPIVError(unknown_key(f"{dotted}.{key}", known))
            _set(tables, f"{dotted}.{key}", each, known)
        return
    *path, last = dotted.split(".")
    for name in path:
        tables = tables.setdefault(name, {})
    if value is None:
        tables.pop(last, None)
    else:
        tables[last] = _plain(value)


def _plain(value: Any) -> Any:
    """As a file could hold it: arrays as lists, paths as text."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
