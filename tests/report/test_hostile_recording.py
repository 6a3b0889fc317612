"""From files that carry hostile text to the report, to ``check``'s words and to its picture."""

import warnings

import numpy as np
import pytest
import tifffile
from hostile_recording import NAMES, make, tag_with
from pages import Parsed, everything, example, without_figures, write
from test_hostile_text import HOSTILE

import plenopiv
from plenopiv.checks import CheckResult, Finding
from plenopiv.checks.stamps import same_camera, stamp
from plenopiv.cli import main
from plenopiv.errors import printable
from plenopiv.recording.sources import only_source
from plenopiv.report.check import check_figure
from plenopiv.report.figures import png
from plenopiv.report.light_field import contact_sheet, depth_strip


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The experiment file of a hostile recording."""
    return make(tmp_path_factory.mktemp("hostile") / "recording")


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_tags_and_comments_of_a_whole_run_stay_text(recording, tmp_path, monkeypatch):
    result = plenopiv.process(plenopiv.load(recording))
    text = (result.directory / "report.html").read_text(encoding="utf-8")
    page = Parsed(text)
    for name in (*NAMES, recording.name):
        assert name in page.text
    without_figures(monkeypatch)
    usual = Parsed(write(tmp_path / "usual.html", example(), **everything(example())))
    assert {tag for tag, _ in page.elements} <= {tag for tag, _ in usual.elements}
    assert len([raw for raw in page.raw if "id" not in raw[1]]) == 2  # the page's own style and script
    assert not any(name.startswith("on") or name == "style" for _, a in page.elements for name in a)
    for path in result.directory.glob("*.json"):
        assert "evil.invalid" not in path.read_text()
    assert "evil.invalid" not in text  # no tag and no comment gets into the page at all


@pytest.mark.full
@pytest.mark.filterwarnings("ignore:Glyph")
def test_a_check_prints_and_draws_what_files_call_themselves(recording, capsys):
    main(["check", str(recording)])
    out = capsys.readouterr().out
    assert NAMES[0] in " ".join(out.split())
    assert all(c.isprintable() or c == "\n" for c in out)
    assert (recording.parent / "look" / "check.png").stat().st_size > 10_000


@pytest.mark.parametrize("text", HOSTILE, ids=range(50))
def test_a_tag_is_printed_without_what_a_terminal_obeys(tmp_path, text):
    for name, content in (("a.tif", text), ("white.tif", f"other {text}")):
        tifffile.imwrite(tmp_path / name, np.arange(400, dtype=np.uint16).reshape(20, 20))
        tag_with(tmp_path / name, content)
    marks = [(name, stamp(only_source(tmp_path / name))) for name in ("a.tif", "white.tif")]
    assert all(mark.taken_s is None for _, mark in marks)
    finding = same_camera(*marks)
    assert finding is not None
    assert "'other" in finding.words
    assert finding.words.isprintable()
    assert len(finding.words) < 250


@pytest.mark.full
@pytest.mark.parametrize("text", [HOSTILE[0], *HOSTILE[45:]], ids=range(6))
@pytest.mark.filterwarnings("ignore:Glyph")
def test_pictures_of_check_views_and_refocus_take_any_name(text):
    """Dollars begin mathematics in matplotlib, underscores hide a label; control characters have no glyph."""
    image = np.random.default_rng(0).integers(60, 900, (224, 280)).astype(np.uint16)
    said = HOSTILE if text == HOSTILE[0] else [text]  # all of them once
    findings = tuple(Finding("x", "warning", f"{hostile} is a name") for hostile in said)
    assert png(check_figure(CheckResult(findings, example().camera(), text, image, image)))
    axis = np.linspace(-1, 1, 20)
    assert png(contact_sheet([[image[:20, :20]]], axis[:1], axis[:1], axis, axis[::-1], text))
    assert png(depth_strip([image[:20, :20]], [0.0], axis, axis[::-1], text))


def test_an_error_prints_no_code_that_a_terminal_obeys(tmp_path, capsys):
    assert main(["info", str(tmp_path / "\x1b[31mred\udcff.tif")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.strip().isprintable()
    assert "?[31mred?.tif: no such file" in error


def test_text_on_one_line():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert printable("a\nb\x1b[31m\u2028\udcff ä 日本 $") == "a?b?[31m?? ä 日本 $"
