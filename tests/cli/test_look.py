"""check, views and refocus, and how the program speaks to programs."""

import io
import json
import re
import subprocess
import sys

import numpy as np
import pytest
import tifffile
from drafted_recording import edit
from matplotlib.figure import Figure
from test_work import SIMULATION

from plenopiv.cli import main
from plenopiv.cli import progress as progress_module
from plenopiv.cli.terminal import coloured, terminal
from plenopiv.run.light_field_images import Views

LATTICE = "rotation_deg = 0.4\noffset_mm = [0.01, 0.02]\npitch_mm = 0.077 "


@pytest.fixture
def made(folder, tmp_path, capsys):
    """A small synthetic recording's experiment file."""
    file = folder / "experiment.toml"
    file.write_text(file.read_text() + SIMULATION.replace("= 0.1\n", "= 1.0\n").replace("rays = 200", "rays = 1000"))
    edit(folder, "pitch_mm = 0.077 ", LATTICE)
    assert main(["simulate", str(file), str(tmp_path / "made")]) == 0
    capsys.readouterr()
    return tmp_path / "made" / "experiment.toml"


@pytest.fixture(autouse=True)
def words_again():
    yield
    terminal.take_flags([])


def events(text):
    return [json.loads(line) for line in text.splitlines()]


def is_picture(path):
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_check_says_good_and_draws(made, capsys):
    assert main(["check", str(made)]) == 0
    out = capsys.readouterr().out
    assert "f-numbers match" in out
    assert "\x1b" not in out
    assert is_picture(made.parent / "look" / "check.png")


@pytest.mark.full
def test_check_as_json_of_a_spoilt_recording(made, capsys):
    white = made.parent / "white.tif"
    tifffile.imwrite(white, np.ascontiguousarray(tifffile.imread(white)[:, ::-1]))
    assert main(["check", str(made), "--json"]) == 2
    out, err = capsys.readouterr()
    assert err == ""
    *before, last = events(out)
    assert {event["event"] for event in before} <= {"progress", "warning", "note"}
    stages = [event["stage"] for event in before if event["event"] == "progress"]
    assert "white image" in stages
    assert (last["event"], last["command"], last["usable"]) == ("result", "check", False)
    flipped = [finding for finding in last["findings"] if finding["name"] == "flipped"]
    assert "mirrored left to right" in flipped[0]["words"]
    assert is_picture(made.parent / "look" / "check.png")


@pytest.mark.full
def test_views_and_refocus_draw(made, capsys, one_line):
    assert main(["views", str(made), "b.tif", "--across", "3"]) == 0
    assert is_picture(made.parent / "look" / "views-b.png")
    assert main(["--quiet", "refocus", str(made), "2", "--z", "-1", "--z", "0.5"]) == 0
    assert is_picture(made.parent / "look" / "refocus-b.png")
    assert capsys.readouterr().out.splitlines()[-1].endswith("refocus-b.png")
    assert "is no frame of this recording; give a name (a.tif, b.tif)" in one_line("views", made, "c.tif")
    assert "main lens, which is at z = 100 mm" in one_line("refocus", made, "--z", "120")


def test_pictures_of_frames_of_one_name_are_different_files(folder, monkeypatch):
    for k, name in enumerate(("frame9.tif", "frame10.tif"), 1):
        (folder / f"p{k}").mkdir()
        (folder / name).rename(folder / f"p{k}" / "a.tif")
    file = folder / "experiment.toml"
    file.write_text(re.sub(r"frames = .*", 'frames = ["p1/a.tif", "p2/a.tif"]\ndrift = "none"', file.read_text()))
    images = "plenopiv.run.light_field_images"
    monkeypatch.setattr(f"{images}.calibrated_camera", lambda experiment, recording: (experiment.camera(), None))
    monkeypatch.setattr(f"{images}.decode", lambda image, layout: image)
    monkeypatch.setattr(f"{images}.views", lambda lightfield, across: Views([], *(np.zeros(1),) * 4))
    monkeypatch.setattr(f"{images}.focal_stack", lambda lightfield, z, progress: ([], np.zeros(1), np.zeros(1)))
    for drawing in ("contact_sheet", "depth_strip"):
        monkeypatch.setattr(f"plenopiv.report.light_field.{drawing}", lambda *shown: Figure())
    for number in ("1", "2"):
        assert main(["views", str(file), number]) == 0
        assert main(["refocus", str(file), number, "--z", "0"]) == 0
    assert sorted(path.name for path in (folder / "look").iterdir()) == [
        "refocus-a-0.png", "refocus-a-1.png", "views-a-0.png", "views-a-1.png"
    ]  # fmt: skip


def test_refocus_asks_for_depths_that_are_in_front_of_the_lens(folder, one_line):
    for z in ("-inf", "nan", "inf", "120"):
        line = one_line("refocus", folder / "experiment.toml", f"--z={z}")
        assert f"--z {z}: depths must be finite, in front of the main lens, which is at z = 100 mm" in line
    assert not (folder / "look").exists()


def test_errors_and_results_as_json(tmp_path, capsys):
    assert main(["info", str(tmp_path / "none.toml"), "--json"]) == 2
    (event,) = events(capsys.readouterr().out)
    assert event["event"] == "error"
    assert event["exit_code"] == 2
    assert "no such file" in event["message"]
    assert main(["--json", "rn"]) == 2
    assert "No such command" in events(capsys.readouterr().out)[0]["message"]
    image = tmp_path / "a.tif"
    tifffile.imwrite(image, np.arange(400, dtype=np.uint16).reshape(20, 20))
    assert main(["info", "--json", str(image)]) == 0
    (event,) = events(capsys.readouterr().out)
    assert (event["event"], event["command"]) == ("result", "info")
    assert main(["info", str(image)]) == 0
    assert capsys.readouterr().out.startswith("size ")


def test_flags_after_two_dashes_are_left_alone():
    assert terminal.take_flags(["run", "--json", "--", "-q"]) == ["run", "--", "-q"]
    assert (terminal.as_json, terminal.quiet) == (True, False)


def fed(monkeypatch, times, stages):
    clock = iter(times)
    monkeypatch.setattr(progress_module, "perf_counter", lambda: next(clock))
    with progress_module.Progress() as progress:
        for stage in stages:
            progress(*stage)


STAGES = [("tracing", 0, 10), ("tracing", 5, 10), ("tracing", 6, 10), ("tracing", 10, 10)]


def test_progress_tells_what_is_left(monkeypatch, capsys):
    fed(monkeypatch, [0, 0, 0, 40, 41, 80], STAGES)
    assert capsys.readouterr().err.splitlines() == [
        "plenopiv: tracing: 50 %, about 40 s left",
        "plenopiv: tracing: 80.0 s",
    ]


def test_progress_as_json_is_thinned(monkeypatch, capsys):
    terminal.take_flags(["--json"])
    fed(monkeypatch, [0, 0, 0, 4, 4.2, 8], STAGES)
    said = events(capsys.readouterr().out)
    assert [(event["done"], event["eta_s"]) for event in said] == [(0, None), (5, 4.0), (10, 0.0)]


def test_quiet_leaves_progress_and_notes_out(monkeypatch, capsys):
    terminal.take_flags(["-q"])
    fed(monkeypatch, [0, 0, 0, 40, 41, 80], STAGES)
    terminal.note("memory: about 1 GB")
    assert capsys.readouterr() == ("", "")
    terminal.warning("f-numbers\ndo not match")
    assert capsys.readouterr().err == "plenopiv: warning: f-numbers do not match\n"


@pytest.fixture
def on_a_terminal(monkeypatch):
    """Progress that a person watches, a second from one call to the next."""
    monkeypatch.setattr("sys.stderr", io.StringIO())
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    ticks = iter(range(10_000))
    monkeypatch.setattr(progress_module, "perf_counter", lambda: float(next(ticks)))
    return progress_module.Progress()


def test_of_a_long_series_the_last_bars_stay(on_a_terminal):
    """A terminal holds a few bars, not one for each of a thousand frames; one that goes on is never forgotten."""
    with on_a_terminal as shown:
        for frame in range(300):
            shown("pairs", frame, 300)
            for done in (0, 1, 2):
                shown(f"reconstruction of {frame}", done, 2)
        bars = [task.description for task in shown._bars.tasks]
    assert bars == ["pairs", *(f"reconstruction of {frame}" for frame in range(293, 300))]


def test_a_stage_may_end_while_many_others_have_not(on_a_terminal):
    """As where a tile without candidates reports nothing."""
    with on_a_terminal as shown:
        shown("pairs", 0, 20)
        for frame in range(20):
            shown(f"reconstruction of {frame}", 1, 2)
        shown("pairs", 20, 20)
        shown("pairs", 20, 20)
        assert len(shown._bars.tasks) >= 20


class Terminal:
    def __init__(self, is_one):
        self.isatty = lambda: is_one


def test_colours_on_a_terminal_alone(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert coloured("good", "green", Terminal(True)) == "\x1b[32mgood\x1b[0m"
    assert coloured("good", "green", Terminal(False)) == "good"
    monkeypatch.setenv("NO_COLOR", "1")
    assert coloured("good", "green", Terminal(True)) == "good"


@pytest.mark.skipif(sys.platform == "win32", reason="bash")
def test_bash_completes_commands():
    program = "from plenopiv.cli import main; main()"
    environment = {"_PLENOPIV_COMPLETE": "complete_bash", "COMP_WORDS": "plenopiv re", "COMP_CWORD": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, env=environment, check=False
    )
    assert ended.stdout.split() == ["refocus"]
