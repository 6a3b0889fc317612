"""Where output goes: terminals that lack letters, disks that are full."""

import io
import subprocess
import sys
from pathlib import Path

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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux alone has a disk that is always full")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--json", "info", "none.toml"], "none.toml: no such file"),
        (["--json", "info", "experiment.toml"], "stdout: No space left on device"),
        (["info", "experiment.toml"], "stdout: No space left on device"),
    ],
)
def test_output_to_a_full_disk_is_one_line(folder, arguments, said):
    command = [sys.executable, "-m", "plenopiv", *arguments]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, cwd=folder)
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"plenopiv: error: {said}")
    assert ended.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other pipes")
def test_an_error_whose_reader_went_away_is_a_line(folder):
    command = [sys.executable, "-m", "plenopiv", "--json", "info", "none.toml"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder) as started:
        started.stdout.close()
        line = started.stderr.read()
    assert started.returncode == 2
    assert line.startswith("plenopiv: error: none.toml: no such file")
    assert line.count("\n") == 1
