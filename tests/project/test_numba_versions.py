"""The bounds on Numba's version are those that were tried: campaigns/numba_versions.py."""

import json
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[2]
TRIED = json.loads((ROOT / "campaigns" / "results" / "numba_versions.json").read_text())


def test_the_bounds_are_what_was_tried():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (numba,) = (r for r in map(Requirement, declared) if r.name == "numba")
    lowest, highest = (TRIED[name]["versions"]["numba"] for name in ("lowest", "highest"))
    assert [Version(s.version) for s in numba.specifier if s.operator == ">="] == [Version(lowest)]
    assert numba.specifier.contains(highest)
    (locked,) = (line for line in (ROOT / "requirements.txt").read_text().splitlines() if line.startswith("numba=="))
    assert locked == f"numba=={highest}"
    major, minor, *_ = map(int, highest.split("."))
    assert not numba.specifier.contains(f"{major}.{minor + 1}.0")


def test_all_tests_passed_there():
    for found in TRIED.values():
        assert found["failed"] == 0, found["failing"]
        assert found["passed"] > 500
