"""Errors, warnings, exit codes, help, start-up and progress."""

import json
import os
import shlex
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from drafted_recording import edit
from typer.main import get_command

from plenopiv.cli import app, main
from plenopiv.cli.terminal import Terminal, command_line
from plenopiv.errors import PlenoPIVWarning


def test_usage_errors_are_one_line_too(one_line):
    assert "No such command 'rn'" in one_line("rn")
    assert "Missing argument 'EXPERIMENT'; see plenopiv run --help" in one_line("run")
    assert "No such option" in one_line("run", "a.toml", "--fast")


def test_warnings_are_one_line_each_and_do_not_stop(folder, capsys):
    file = edit(folder, "aperture_mm = 25.0", "aperture_mm = 20.0")
    assert main(["info", str(file)]) == 0
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("plenopiv: warning: ")
    assert "f-numbers do not match" in err


def test_info_names_the_inner_windows(folder, capsys):
    file = edit(folder, "overlap = 0.5", "overlap = 0.5\ninner_window = [24, 24, 12]")
    assert main(["info", str(file)]) == 0
    assert "24 x 24 x 12 voxels; a vector is their mean over the last window" in capsys.readouterr().out


def test_a_warning_is_said_once_and_others_are_left_alone(monkeypatch, capsys):
    import plenopiv.cli.info

    def warned(file):
        for _ in range(3):
            warnings.warn("frame 1 is\nbright", PlenoPIVWarning, stacklevel=1)
        return "done"

    monkeypatch.setattr(plenopiv.cli.info, "info", warned)
    assert main(["info", "any"]) == 0
    assert capsys.readouterr() == ("done\n", "plenopiv: warning: frame 1 is bright\n")


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (KeyboardInterrupt(), 130, "plenopiv: interrupted\n"),
        (
            MemoryError("60 GB"),
            2,
            "plenopiv: error: not enough memory (60 GB); use larger voxels or a smaller volume\n",
        ),
        (PermissionError(13, "Permission denied", "a.tif"), 2, "plenopiv: error: a.tif: Permission denied\n"),
    ],
)
def test_other_ends_have_their_line_and_code(monkeypatch, capsys, error, code, line):
    import plenopiv.cli.info

    def fail(file):
        raise error

    monkeypatch.setattr(plenopiv.cli.info, "info", fail)
    assert main(["info", "any"]) == code
    assert capsys.readouterr().err == line


def test_a_fault_of_the_program_is_not_hidden(monkeypatch):
    import plenopiv.cli.info

    monkeypatch.setattr(plenopiv.cli.info, "info", lambda file: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["info", "any"])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM to catch")
def test_termination_unwinds(monkeypatch):
    import plenopiv.cli.info

    cleaned = []

    def interrupted(file):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            signal.pause()
        finally:
            cleaned.append(True)

    monkeypatch.setattr(plenopiv.cli.info, "info", interrupted)
    with pytest.raises(SystemExit, match="143"):
        main(["info", "any"])
    assert cleaned == [True]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGHUP to catch")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGHUP", 129), ("SIGINT", 130)])
def test_a_library_that_fails_on_the_way_out_does_not_hide_the_signal(monkeypatch, name, code):
    """As matplotlib does when a signal comes while a figure is saved."""
    import plenopiv.cli.info

    def interrupted(file):
        try:
            os.kill(os.getpid(), getattr(signal, name))
            signal.pause()
        finally:
            raise AttributeError("no such attribute")

    monkeypatch.setattr(plenopiv.cli.info, "info", interrupted)
    number = getattr(signal, name)
    before = signal.signal(number, signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL)
    try:  # what started the tests may ignore it, as nohup and a shell's & do
        ended = main(["info", "any"])
    except SystemExit as error:
        ended = error.code
    finally:
        signal.signal(number, before)
    assert ended == code


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals to catch")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGHUP", 129)])
def test_the_last_event_of_a_run_that_is_terminated_says_so(monkeypatch, capsys, name, code):
    import plenopiv.cli.info

    def ended(file):
        os.kill(os.getpid(), getattr(signal, name))
        signal.pause()

    monkeypatch.setattr(plenopiv.cli.info, "info", ended)
    number = getattr(signal, name)
    before = signal.signal(number, signal.SIG_DFL)  # what started the tests may ignore it
    try:
        with pytest.raises(SystemExit, match=str(code)):
            main(["--json", "info", "any"])
    finally:
        signal.signal(number, before)
    assert json.loads(capsys.readouterr().out) == {"event": "error", "message": "terminated", "exit_code": code}


@pytest.mark.parametrize("command", [[], *([name] for name in get_command(app).commands)])
def test_help_teaches_by_example(command, capsys):
    assert main([*command, "--help"]) == 0
    assert f"plenopiv {' '.join(command)}" in capsys.readouterr().out.replace("Usage: plenopiv", "")


HEAVY = ("numpy", "scipy", "numba", "xarray", "matplotlib", "dask", "tifffile", "h5netcdf", "rich")


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["check", "--help"], ["--version"]])
def test_help_loads_nothing_heavy(arguments):
    program = (
        "import sys; from plenopiv.cli import main; code = main(sys.argv[1:]); "
        f"print('loaded', [name for name in {HEAVY!r} if name in sys.modules]); sys.exit(code)"
    )
    ended = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0
    assert ended.stdout.splitlines()[-1] == "loaded []"


def test_import_loads_nothing_heavy():
    program = (
        "import sys, plenopiv, plenopiv.experiment; "
        "print([n for n in ('numba', 'scipy', 'xarray', 'matplotlib', 'dask') if n in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.strip() == "[]"


def test_progress_prints_a_line_for_a_long_stage_off_a_terminal(capsys, monkeypatch):
    from plenopiv.cli import progress as module

    clock = iter([0.0, 0.0, 0.0, 1.0, 1.5, 5.0, 6.0])
    monkeypatch.setattr(module, "perf_counter", lambda: next(clock))
    with module.Progress() as progress:
        progress("calibration", 0, 1)
        progress("calibration", 1, 1)
        progress("reconstruction", 2, 10)
        progress("reconstruction", 10, 10)
        progress("reconstruction", 10, 10)
    assert capsys.readouterr().err == "plenopiv: reconstruction: 3.5 s\n"


def test_progress_draws_a_bar_on_a_terminal_after_two_seconds(capsys, monkeypatch):
    from plenopiv.cli import progress as module

    now = [0.0]
    monkeypatch.setattr(module, "perf_counter", lambda: now[0])
    with module.Progress() as progress:
        monkeypatch.setattr(progress, "_on_terminal", True)
        progress("reconstruction", 1, 10)
        assert capsys.readouterr().err == ""
        now[0] = 2.5
        progress("reconstruction", 5, 10)
    assert "reconstruction" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["a b.toml", "l'été.toml", "流れ.toml", '"$HOME" `x`; y.toml', "-x.toml", "~/a.toml", "#1.toml"]
)
def test_command_lines_are_pasted_as_they_are(name):
    words = shlex.split(command_line("run", Path(name)))
    assert words[:2] == ["plenopiv", "run"]
    assert Path(words[2]) == Path(name)
    assert not words[2].startswith("-")
    assert command_line("run", Path("run7/experiment.toml")) == "plenopiv run run7/experiment.toml"


def test_a_message_that_holds_a_whole_file_is_cut(capsys):
    """A unit or a name may be text of any length."""
    assert Terminal().error(f"flow.nc: x is in '{'a' * 5000}'", 2) == 2
    line = capsys.readouterr().err
    assert line.startswith("plenopiv: error: flow.nc: x is in 'aaa")
    assert line.endswith("a...\n")
    assert len(line) < 1100
