"""Where output goes: terminals that lack letters."""

import io
import sys

import pytest

from plenopiv.cli import main


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "utf-8"])
def test_letters_that_a_terminal_lacks_are_escapes(monkeypatch, encoding):
    import plenopiv.cli.info

    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
    monkeypatch.setattr(plenopiv.cli.info, "info", lambda file: "5 – 7 mm, D\udcfcse.tif")
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["info", "any"]) == 0
    out.flush()
    dash = "–" if encoding == "utf-8" else "\\u2013"
    assert out.buffer.getvalue().decode(encoding) == f"5 {dash} 7 mm, D\\udcfcse.tif\n"


def test_a_stream_of_a_notebook_is_left_as_it_is(monkeypatch):
    import plenopiv.cli.info

    out = io.StringIO()
    monkeypatch.setattr(plenopiv.cli.info, "info", lambda file: "5 – 7 mm")
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["info", "any"]) == 0
    assert out.getvalue() == "5 – 7 mm\n"
