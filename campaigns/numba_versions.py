"""The kernels' tests at the lowest and the highest version of Numba that pyproject.toml allows:  numba_versions.py

Each version gets an environment and a cache of kernels of its own under build/numba_versions; NumPy, SciPy and others
are what pip finds to go with it. Writes campaigns/results/numba_versions.json: versions, tests passed, failed and
skipped, seconds, and a hash of the sources that they hold for. What is recorded for the sources as they are is not run
again.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
import tomllib
import venv
import xml.etree.ElementTree as xml
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "numba_versions"
RESULTS = ROOT / "campaigns" / "results" / "numba_versions.json"
TESTS = ("tests/projection", "tests/displacement", "tests/reconstruction")
TESTED = ("src/plenopiv", *TESTS, "tests/oracles", "tests/conftest.py")
LIBRARIES = ("numba", "llvmlite", "numpy", "scipy")
ASK = "import importlib.metadata as m, json, sys; print(json.dumps({n: m.version(n) for n in sys.argv[1:]}))"


def bounds() -> dict[str, str]:
    """What pip is asked for."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (numba,) = (r for r in map(Requirement, declared) if r.name == "numba")
    (lowest,) = (s.version for s in numba.specifier if s.operator == ">=")
    return {"lowest": f"numba=={lowest}", "highest": str(numba)}


def sources_hash(names: tuple[str, ...] = TESTED) -> str:
    """Of the Python files there; all that is tested here."""
    digest = hashlib.sha256()
    for name in names:
        path = ROOT / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def environment(name: str, wanted: str) -> Path:
    """Python in an environment that holds PlenoPIV's dependencies and the wanted Numba."""
    folder, stamp = BUILD / name, BUILD / name / "wanted.txt"
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not stamp.exists() or stamp.read_text() != wanted:
        venv.create(folder, clear=True, with_pip=True)
        command = [
            str(python),
            "-m",
            "pip",
            "install",
            "--quiet",
            "--editable",
            str(ROOT),
            wanted,
            "pytest",
            "pytest-xdist",
        ]
        subprocess.run(command, check=True)
        stamp.write_text(wanted)
    return python


def tested(name: str, wanted: str) -> dict[str, object]:
    """Run the tests, and count."""
    python = environment(name, wanted)
    asked = [python, "-c", ASK, *LIBRARIES]
    versions = json.loads(subprocess.run(asked, check=True, capture_output=True, text=True).stdout)
    print(f"{name}: {versions}", flush=True)
    report = BUILD / f"{name}.xml"
    report.unlink(missing_ok=True)
    variables = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    variables["XDG_CACHE_HOME"] = str(BUILD / f"{name}-cache")
    command = [python, "-m", "pytest", "-n", "auto", "--dist", "worksteal", "-m", "not full", "-p", "no:cacheprovider"]
    begin = time.perf_counter()
    subprocess.run([*command, f"--junitxml={report}", *TESTS], cwd=ROOT, env=variables, check=False)
    seconds = time.perf_counter() - begin
    (suite,) = xml.parse(report).getroot()
    count = {key: int(suite.get(key, 0)) for key in ("tests", "failures", "errors", "skipped")}
    failing = [f"{c.get('classname')}::{c.get('name')}" for c in suite if c.find("failure") is not None]
    return {
        "versions": versions,
        "python": ".".join(map(str, sys.version_info[:3])),
        "passed": count["tests"] - count["failures"] - count["errors"] - count["skipped"],
        "failed": count["failures"] + count["errors"],
        "failing": failing,
        "skipped": count["skipped"],
        "seconds": round(seconds, 1),
    }


def main() -> None:
    """Run what is not recorded yet; exit 1 where a test failed."""
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name, wanted in bounds().items():
        state = {"wanted": wanted, "sources": sources_hash()}
        if name in found and found[name].items() >= state.items():
            print(f"{name}: recorded for these sources")
            continue
        found[name] = state | tested(name, wanted)
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    sys.exit(any(entry["failed"] for entry in found.values()))


if __name__ == "__main__":
    main()
