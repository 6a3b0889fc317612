"""The small camera of the cases, what is recorded of them, and tables in docs/tracking.md."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

sys.path.append(str(Path(__file__).parents[1]))
import fresh
import page_tables

PAGE = Path(__file__).parents[2] / "docs" / "tracking.md"


def camera_and_volume(columns: int, depth_mm: float) -> tuple[PlenopticCamera, tuple]:
    """A camera of PMR 14 and M = -1, and the limits in mm of what all of its views see of so deep a volume."""
    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
        0.308,
        Sensor(columns, columns, 0.0055, 12, 60),
    )
    half, deep = columns * 0.0055 / 2 - 0.16 * depth_mm / 4, depth_mm / 2
    return camera, ((-half, half), (-half, half), (-deep, deep))


def run_cases(
    path: Path, cases: Mapping[str, dict], base: dict, measure: Callable[..., dict], page: Callable[[dict], None]
) -> None:
    """Measure the cases named on the command line, "all" of them, or without a name those that are not of today's
    program, and record each at ``path``; then write the ``page``, which ``page`` as the only word does alone."""
    stored, today, asked = json.loads(path.read_text()) if path.exists() else {}, fresh.stamp(path), sys.argv[1:]
    old = [name for name in cases if stored.get(name, {}).get("made_with") != today]
    for name in () if asked == ["page"] else cases if asked == ["all"] else asked or old:
        stored[name] = measure(**base | cases[name]) | {"made_with": today}
        print(name, json.dumps(stored[name], indent=1))
        stored = {name: stored[name] for name in cases if name in stored}
        path.write_text(json.dumps(stored, indent=1) + "\n")
    page({name: {key: own for key, own in case.items() if key != "made_with"} for name, case in stored.items()})


def write_table(name: str, lines: Iterable[str]) -> None:
    """Put ``lines`` between the marks of that name in docs/tracking.md."""
    page_tables.put(PAGE, name, lines)


def three(values: Sequence[float], digits: int = 3) -> str:
    """Values along x, y and z in a cell."""
    return " / ".join(f"{each:.{digits}f}" for each in values)
