"""What is shipped: metadata, lock files, licence, entry points."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import grimp
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import plenopiv

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCKS = ("requirements.txt", "requirements-dev.txt")
OTHER_LOCKS = ("requirements-docs.txt",)
IMPORTED_AS = {"tomli-w": "tomli_w"}
INDIRECT = {"h5netcdf", "h5py", "imagecodecs"}  # xarray's engine by name, what it stands on, tifffile's codecs
INDIRECT |= {"dask-jobqueue"}  # for the user's script
# Packages under the GPL that are tempting in this field; some pull it in underneath.
COPYLEFT = {"pyfftw", "openpiv", "astra-toolbox", "pivpy", "pyqt5", "pyqt6"}


READERS = ("lavision", "cluster", "gpu")  # extras whose packages the program imports where a user asks for them


def pins(*names):
    lines = [line for name in names for line in (ROOT / name).read_text().splitlines()]
    return [line for line in lines if line and not line.startswith("-r ")]


def test_the_version_is_said_once():
    assert plenopiv.__version__ == PROJECT["version"]
    newest = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest
    assert newest[1] in ("Unreleased", PROJECT["version"])


def test_lock_files_hold_exact_versions_and_no_addresses():
    for line in pins(*LOCKS, *OTHER_LOCKS):
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", line), line
    assert (ROOT / "requirements-dev.txt").read_text().startswith("-r requirements.txt\n")


@pytest.mark.parametrize(("lock", "wanted"), [(LOCKS[:1], "dependencies"), (LOCKS, "dev")])
def test_lock_files_satisfy_the_project(lock, wanted):
    locked = {canonicalize_name(name): version for name, _, version in (pin.partition("==") for pin in pins(*lock))}
    declared = PROJECT["dependencies"] if wanted == "dependencies" else PROJECT["optional-dependencies"]["dev"]
    for requirement in map(Requirement, declared):
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), requirement
    assert not COPYLEFT & set(locked)


def test_the_hashed_lock_file_holds_the_same_versions_and_no_addresses():
    text = (ROOT / "requirements-hashed.txt").read_text()
    found = re.findall(r"^(\S+==\S+)( ; [^\\\n]+?)?((?: \\\n    --hash=sha256:[0-9a-f]{64})+)$", text, re.MULTILINE)
    here = {pin for pin, elsewhere, _ in found if not elsewhere}
    assert {pin.lower() for pin in here} == {pin.lower() for pin in pins("requirements.txt")}
    assert len(found) == text.count("==") - text.count(" == ")  # nothing without a hash
    assert "://" not in text
    assert "index" not in text


def test_the_citation_is_of_this_version():
    text = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {PROJECT['version']}\n" in text
    assert f"\nlicense: {PROJECT['license']}\n" in text
    assert [author["name"] for author in PROJECT["authors"]] == re.findall(r"^  - name: (.+)$", text, re.MULTILINE)


def test_classifiers_and_the_workflow_name_the_same_pythons():
    stated = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", text)]
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text()
    assert re.findall(r'"(3\.\d+)"', re.search(r"python: \[(.*)\]", workflow)[1]) == stated
    assert PROJECT["requires-python"] == f">={stated[0]}"


def test_dependencies_are_those_imported():
    graph = grimp.build_graph("plenopiv", include_external_packages=True, cache_dir=None)
    imported = {m for m in graph.modules if not m.startswith("plenopiv")} - set(sys.stdlib_module_names)
    extras = [text for extra, texts in PROJECT["optional-dependencies"].items() if extra in READERS for text in texts]
    declared = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"] + extras}
    assert {IMPORTED_AS.get(name, name) for name in declared - INDIRECT} == imported - INDIRECT


def test_the_command_is_installed():
    (command,) = entry_points(group="console_scripts", name="plenopiv")
    assert command.value == "plenopiv.cli:main"
    assert callable(command.load())


def test_the_licence_is_bsd():
    assert PROJECT["license"] == "BSD-3-Clause"
    text = (ROOT / "LICENSE").read_text()
    assert "Redistribution and use in source and binary forms" in text
    assert "Neither the name" in text


def test_types_are_shipped():
    assert (ROOT / "src" / "plenopiv" / "py.typed").is_file()


@pytest.mark.parametrize("target", ["demo", "test"])
def test_the_two_commands_set_themselves_up(target, tmp_path):
    """On a fresh checkout both commands begin with the virtual environment and the lock file (a dry run)."""
    outside = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    command = ["make", "--dry-run", f"VENV={tmp_path / 'venv'}", target]
    plan = subprocess.run(command, cwd=ROOT, env=outside, capture_output=True, text=True, timeout=60)
    assert plan.returncode == 0, plan.stderr
    steps = ["-m venv", "install --quiet -r requirements.txt", "--editable .", f"touch {tmp_path / 'venv' / '.ready'}"]
    steps.append({"demo": "plenopiv demo demo --overwrite", "test": "-m pytest"}[target])
    places = [plan.stdout.find(step) for step in steps]
    assert -1 not in places
    assert places == sorted(places)


def test_no_file_knows_where_it_was_written():
    """The path of a checkout in a file works on one machine alone."""
    here = re.compile(rf"(?<![\w.-]){re.escape(str(ROOT.resolve()))}(?![\w-])")
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.is_file() and path.suffix in {".py", ".md", ".toml", ".txt", ".json", ""}:
            assert not here.search(path.read_text(encoding="utf-8", errors="replace")), name
