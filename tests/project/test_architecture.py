"""The order of the rooms: the contracts in pyproject.toml hold, and would fail if a room reached up."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
ROOMS = [room.strip("()") for room in CONTRACTS[0]["layers"]]


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("plenopiv", cache_dir=None)


def upward(graph):
    present = [room for room in ROOMS if f"plenopiv.{room}" in graph.modules]
    return graph.find_illegal_dependencies_for_layers(layers=present, containers={"plenopiv"})


def test_all_contracts_hold():
    """As ``make lint`` runs them."""
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stdout


def test_an_upward_import_would_be_seen(graph):
    assert upward(graph) == set()
    changed = grimp.build_graph("plenopiv", cache_dir=None)
    changed.add_import(importer="plenopiv.optics", imported="plenopiv.volume")
    assert [(d.importer, d.imported) for d in upward(changed)] == [("plenopiv.optics", "plenopiv.volume")]


def test_a_circle_within_a_subpackage_would_be_seen(graph):
    assert not graph.nominate_cycle_breakers("plenopiv.simulation")
    changed = grimp.build_graph("plenopiv", cache_dir=None)
    changed.add_import(importer="plenopiv.simulation.file_grid", imported="plenopiv.simulation.flow_file")
    assert changed.nominate_cycle_breakers("plenopiv.simulation")


def test_every_room_is_in_the_order():
    rooms = {path.stem for path in (ROOT / "src" / "plenopiv").iterdir() if path.suffix == ".py" or path.is_dir()}
    assert rooms - {"__init__", "__pycache__"} <= set(ROOMS)


def test_the_order_written_down_is_the_order_enforced():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    block = re.search(r"```text\n(errors .*?)```", text, re.DOTALL)
    assert block, "CONTRIBUTING.md lists the rooms in a text block that starts with errors"
    assert [line.split()[0] for line in block[1].splitlines() if line] == ROOMS[::-1]


def test_the_experiment_file_reaches_no_kernels():
    """A mistake in it is told before a kernel library loads."""
    linked = grimp.build_graph("plenopiv", include_external_packages=True, cache_dir=None)
    chain = linked.find_shortest_chain("plenopiv.experiment.file", "numba")
    assert chain is None, " -> ".join(chain or ())


def test_files_fit_in_the_head():
    """No source file above 350 lines, half of them at most 200."""
    lengths = sorted(len(path.read_text().splitlines()) for path in (ROOT / "src").rglob("*.py"))
    assert lengths[-1] <= 350
    assert lengths[len(lengths) // 2] <= 200


def test_the_map_names_every_module():
    """The tree in CONTRIBUTING.md: folders end with a slash, modules are indented below them."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    block = re.search(r"```text\n(cameras/\n.*?)```", text, re.DOTALL)
    assert block
    named, folders = set(), []
    for line in block[1].splitlines():
        depth, name = (len(line) - len(line.lstrip())) // 2, line.split()[0]
        folders = folders[:depth]
        if name.endswith("/"):
            folders.append(name)
        else:
            named.add("".join(folders) + name)
            assert len(line.split()) > 1, line
    package = ROOT / "src" / "plenopiv"
    modules = {path.relative_to(package).with_suffix("").as_posix() for path in package.glob("*/**/*.py")}
    assert named == {module for module in modules if not module.endswith("__init__")}
