"""The documents say what the program does: keys, commands, links."""

import importlib
import json
import re
from pathlib import Path

import pytest
from typer.main import get_command

from plenopiv.cli import app
from plenopiv.experiment.compute import ComputeTable
from plenopiv.experiment.file import Experiment
from plenopiv.experiment.messages import tables_of
from plenopiv.experiment.simulation_tables import SimulationTable
from plenopiv.experiment.tables import CorrelationTable, OutputTable, ReconstructionTable, SensorTable

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
KEYS = (ROOT / "docs" / "experiment-file.md").read_text()
DEFAULTS = {
    "camera.sensor": SensorTable,
    "reconstruction": ReconstructionTable,
    "correlation": CorrelationTable,
    "compute": ComputeTable,
    "output": OutputTable,
    "simulation": SimulationTable,
}


def key_rows():
    """Rows of the page's tables of keys: (table, key) -> default, as written."""
    rows, table = {}, ""
    for line in KEYS.splitlines():
        if heading := re.fullmatch(r"## `\[(.+)\]`.*", line):
            table = heading[1]
        elif table and line.startswith("| `"):
            key, _unit, default, _meaning = (cell.strip() for cell in line.strip("|").split("|"))
            rows[table, key.strip("`")] = default
    return rows


def test_the_page_explains_every_key_and_no_other():
    tables = tables_of(Experiment)
    known = {(table, key) for table, keys in tables.items() for key in keys}
    assert set(key_rows()) == {(t, k) for t, k in known if f"{t}.{k}".lstrip(".") not in tables}


@pytest.mark.parametrize("table", DEFAULTS)
def test_the_page_s_defaults_are_the_program_s(table):
    rows = key_rows()
    for key, field in DEFAULTS[table].model_fields.items():
        if f"{table}.{key}" in tables_of(Experiment):
            continue  # a table of its own
        written = rows[table, key].strip("`")
        if field.is_required():
            assert written == "required", key
        elif field.default in (None, {}):
            assert "`" not in rows[table, key], key  # said in words
        elif isinstance(field.default, bool):
            assert written == str(field.default).lower(), key
        elif isinstance(field.default, str):
            assert written == f'"{field.default}"', key
        else:
            value = json.loads(written)
            assert (tuple(value) if isinstance(value, list) else value) == field.default, key


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text()):
        if not target.startswith(("http://", "https://", "mailto:")):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_commands_in_the_documents_exist():
    commands = get_command(app).commands
    for document in DOCUMENTS:
        for block in re.findall(r"```(?:sh|bash)\n(.*?)```", document.read_text(), re.DOTALL):
            for word in re.findall(r"^\s*(?:\S*/)?plenopiv (\w+)", block, re.MULTILINE):
                assert word in commands, f"{document.name}: plenopiv {word}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_what_the_documents_name_exists(document):
    """Dotted names of the package, and Python files relative to the repository, or to src/plenopiv or below it."""
    text = document.read_text()
    for name in sorted(set(re.findall(r"\bplenopiv(?:\.\w+)+", text))):
        parts = name.split(".")
        for k in range(len(parts), 0, -1):
            try:
                thing = importlib.import_module(".".join(parts[:k]))
            except ModuleNotFoundError:
                continue
            for attribute in parts[k:]:
                assert hasattr(thing, attribute), name
                thing = getattr(thing, attribute)
            break
    for name in re.findall(r"`([\w/.-]+\.py)`", text):
        assert (ROOT / name).exists() or list((ROOT / "src" / "plenopiv").rglob(name)), name


def test_decisions_are_numbered_listed_and_complete():
    folder = ROOT / "docs" / "decisions"
    records = sorted(folder.glob("[0-9]*.md"))
    assert [int(path.name[:4]) for path in records] == list(range(1, len(records) + 1))
    index = (ROOT / "docs" / "index.md").read_text()
    for path in records:
        text = path.read_text()
        assert f"decisions/{path.name}" in index, path.name
        for heading in ("## Context", "## Decision", "## Consequences"):
            assert heading in text, f"{path.name}: {heading}"


def test_the_picture_is_small():
    for picture in (ROOT / "docs" / "images").glob("*.png"):
        assert picture.stat().st_size < 300_000, picture.name
