"""What docs/site lays out for Sphinx, without Sphinx: pages, links that lead somewhere, docstrings as they must be."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import build_site
import make_gallery
import pytest
from docstrings import as_rst
from reference_pages import commands_page, key_types_page

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "source"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_site, "SOURCE", folder)
        build_site.lay_out()
    return folder


def test_links_of_all_pages_lead_somewhere(source):
    pages = list(source.rglob("*.md"))
    assert len(pages) > 90
    for page in pages:
        text = re.sub(r"^(`{3,}).*?^\1", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        for target, _ in build_site.LINK.findall(text):
            assert (page.parent / target).exists(), f"{page.relative_to(source)}: {target}"


def test_every_page_is_in_the_navigation_once(source):
    listed = []
    for page in source.rglob("*.md"):
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
            names = [line for line in tree.splitlines() if line and not line.startswith(":")]
            places = [source / name[1:] if name.startswith("/") else page.parent / name for name in names]
            listed += [place.relative_to(source).as_posix() for place in places]
    orphans = {"index", "readme"} | {
        p.relative_to(source).with_suffix("").as_posix() for p in source.rglob("files/**/*.md")
    }
    assert sorted(listed) == sorted(
        {p.relative_to(source).with_suffix("").as_posix() for p in source.rglob("*.md")} - orphans
    )


def test_a_second_layout_writes_nothing_anew_and_drops_what_is_gone(source):
    (source / "gone.md").write_text("# gone\n")
    before = {page: page.stat().st_mtime_ns for page in source.rglob("*.md")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_site, "SOURCE", source)
        build_site.lay_out()
    assert before.pop(source / "gone.md")
    assert {page: page.stat().st_mtime_ns for page in source.rglob("*.md")} == before


def test_the_gallery_shows_what_is_made():
    page = (ROOT / "docs" / "gallery.md").read_text()
    assert re.findall(r"<!-- report: (\S+) -->", page) == list(make_gallery.RECORDINGS)


def test_commands_and_keys_are_the_program_s():
    page = commands_page()
    assert "## plenopiv correlate\n\n```text\nUsage: plenopiv correlate" in page
    assert "\x1b" not in page
    keys = key_types_page()
    assert "| `black_level` | number >= 0 | `0.0` |" in keys
    assert '| `orientation` | `"upright"`, `"sensor"` | required |' in keys
    assert "## `[calibration.planes]`" in keys


def test_docstrings_become_restructuredtext():
    lines = ["A bar |z| and ``|x|``.", "", "one.py    a thing", "two.py    another", "", "Raises:", "    E: |y|", ""]
    assert as_rst(lines) == [
        "A bar \\|z\\| and ``|x|``.", "", "::", "", "    one.py    a thing", "    two.py    another", "",
        "Raises:", "    E: \\|y\\|", "",
    ]  # fmt: skip


def test_packages_of_extras_are_not_needed_to_read_docstrings():
    """The site is built with the packages of the program alone: what only an extra has is in Sphinx' settings."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    always = {re.match(r"[\w-]+", text)[0].replace("-", "_") for text in project["dependencies"]} | {"plenopiv"}
    imported = set()
    for path in (ROOT / "src" / "plenopiv").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module.partition(".")[0])
    settings = ast.parse((ROOT / "docs" / "site" / "conf.py").read_text()).body
    (mocked,) = [
        n.value for n in settings if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "autodoc_mock_imports"
    ]
    assert imported - always - set(sys.stdlib_module_names) <= set(ast.literal_eval(mocked)) | {"__future__"}
