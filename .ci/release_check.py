"""Wheel and sdist: built into dist/, installed in fresh environments, and tried in an empty folder.

    python .ci/release_check.py

``make release-check`` runs this. The wheel is made from the sdist, which is therefore whole; packages come from
requirements-hashed.txt, hashes compared. Then the demo, and a recording from ``init`` to its report.
"""

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
SDIST, WHEEL = f"plenopiv-{VERSION}.tar.gz", f"plenopiv-{VERSION}-py3-none-any.whl"
BUILD = "import sys, setuptools.build_meta as b; print(getattr(b, sys.argv[1])(sys.argv[2]))"


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints; without the paths of this environment and of the repository."""
    outside = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=outside, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def build(aside: Path) -> None:
    """The sdist from the repository, the wheel from the sdist."""
    DIST.mkdir(exist_ok=True)
    for name in (SDIST, WHEEL):
        (DIST / name).unlink(missing_ok=True)
    run(sys.executable, "-c", BUILD, "build_sdist", DIST, cwd=ROOT)
    with tarfile.open(DIST / SDIST) as packed:
        packed.extractall(aside, filter="data")
    run(sys.executable, "-c", BUILD, "build_wheel", DIST, cwd=aside / SDIST.removesuffix(".tar.gz"))


def environment(folder: Path, built: str) -> Path:
    """The bin folder of a fresh environment with PlenoPIV from a file of dist/."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet"]
    run(*install, "--require-hashes", "-r", ROOT / "requirements-hashed.txt", cwd=folder)
    run(*install, "--no-deps", "--no-build-isolation", DIST / built, cwd=folder)
    where = run(python, "-c", "import plenopiv; print(plenopiv.__file__, plenopiv.__version__)", cwd=folder).split()
    if not Path(where[0]).resolve().is_relative_to(folder.resolve()) or where[1] != VERSION:
        raise SystemExit(f"{built}: what is imported is {where}")
    return folder / "bin"


def tried(bin_folder: Path, folder: Path) -> None:
    """The demo, and its images once more from ``init`` to the report, in an empty folder."""
    folder.mkdir()
    command = bin_folder / "plenopiv"
    print(run(command, "--quiet", "demo", "demo", cwd=folder))
    (folder / "run7").mkdir()
    for name in ("white.tif", "a.tif", "b.tif"):
        shutil.copy(folder / "demo" / name, folder / "run7")
    run(command, "init", "run7", "demo/optics.json", cwd=folder)
    run(command, "--quiet", "run", "run7/experiment.toml", cwd=folder)
    for report in (folder / "demo/results/report.html", folder / "run7/results/report.html"):
        if report.stat().st_size < 100_000:
            raise SystemExit(f"{report}: {report.stat().st_size} bytes are no report")


def main() -> int:
    """Build, install, try; names of the files at the end."""
    with tempfile.TemporaryDirectory() as name:
        aside = Path(name)
        build(aside)
        tried(environment(aside / "of-wheel", WHEEL), aside / "empty")
        of_sdist = environment(aside / "of-sdist", SDIST)
        print(run(of_sdist / "plenopiv", "--version", cwd=aside).strip(), "from the sdist")
    for built in (SDIST, WHEEL):
        print(f"{DIST / built}: {(DIST / built).stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
