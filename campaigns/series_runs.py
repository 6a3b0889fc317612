"""Runs of a small recording for the campaigns with series: each in a process of its own, and what it left.

Processes are forked off this one, which has loaded the program but computed nothing, so that a run takes no second of
Python's start. Frames reconstructed and pairs measured are counted where a run begins them.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

SEED = 26
TIMES = {"time_estimate_s", "machine_speed", "timings_s", "peak_memory_gb", "memory_estimate_gb"}  # of summary.json
OWN_LINES = {"report.html", "summary.json"}  # of the manifest, which hash what has times
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TIFFFILE_NUM_THREADS")


def load() -> None:
    """Load all that a run uses, with one compute thread: a process that has several cannot be forked."""
    for name in THREADS:
        os.environ[name] = "1"
    import h5netcdf  # noqa: F401
    import matplotlib.pyplot  # noqa: F401
    import scipy.interpolate  # noqa: F401
    import tifffile  # noqa: F401
    import xarray  # noqa: F401

    import plenopiv.cli.run
    import plenopiv.report
    import plenopiv.run.series  # noqa: F401


def make_recording(folder: Path, pairs: int, simulated: int | None = None, volumes: bool = False) -> Path:
    """Simulate ``pairs`` pairs of 240 x 224 px and return the experiment file; where fewer are ``simulated``, the
    others are these with other noise."""
    import tifffile

    from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
    from plenopiv.lattice import Lattice
    from plenopiv.sensor import Sensor
    from plenopiv.simulation.flows import flow
    from plenopiv.simulation.simulated_recording import simulate_recording

    lattice = Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023))
    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), lattice, 0.308, Sensor(240, 224, 0.0055, 12, 60))
    simulated, rng = simulated or pairs, np.random.default_rng(SEED)
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(pairs):
        names = [folder / f"run_{number:04d}_{letter}.tif" for letter in "ab"]
        if number < simulated:
            simulate_recording(
                folder / "one",
                camera,
                flow("uniform", velocity_m_s=(0.11, -0.06, 0.17)),
                dt_s=0.0005,
                volume_mm=((-0.4, 0.4), (-0.36, 0.36), (-1.0, 1.0)),
                windows=((28, 28, 20), (20, 20, 16)),
                rays=2000,
                voxel_mm=(0.02, 0.02, 0.077),
                seed=number,
                overwrite=True,
            )
            for letter, name in zip("ab", names, strict=True):
                os.replace(folder / "one" / f"{letter}.tif", name)
            os.replace(folder / "one" / "white.tif", folder / "white.tif")
        else:
            for letter, name in zip("ab", names, strict=True):
                image = tifffile.imread(folder / f"run_{number % simulated:04d}_{letter}.tif")
                noisy = image + np.round(rng.normal(0, 2, image.shape)).astype(int)
                tifffile.imwrite(name, np.clip(noisy, 0, 4095).astype(np.uint16))
    text = (folder / "one" / "experiment.toml").read_text()
    text = re.sub(r"frames = \[.*?\].*", 'pairs = "run_*_{a,b}.tif"', text) + f"volumes = {str(volumes).lower()}\n"
    text = text.replace("iterations = 5", "iterations = 3")
    (folder / "experiment.toml").write_text(text)
    shutil.rmtree(folder / "one")
    return folder / "experiment.toml"


def in_a_child(work: Callable[[], object]) -> None:
    """Do ``work`` in a process of its own.

    Raises ``RuntimeError`` where that fails.
    """
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)
    if os.waitpid(pid, 0)[1]:
        raise RuntimeError("a recording could not be made")


@dataclass
class Ended:
    """How a run ended: exit status, negative for a signal; seconds; lines on stdout and stderr; numbers of the frames
    whose reconstruction it began, those that it made again for the report's pictures, and pairs."""

    status: int
    seconds: float
    out: str
    err: str
    frames: list[int] = field(default_factory=list)
    shown: list[int] = field(default_factory=list)
    pairs: list[int] = field(default_factory=list)

    @property
    def errors(self) -> list[str]:
        """Lines of error."""
        return [line for line in self.err.splitlines() if line.startswith("plenopiv: error: ")]

    @property
    def odd(self) -> list[str]:
        """Lines of stderr that are not the program's own."""
        return [line for line in self.err.splitlines() if not line.startswith("plenopiv: ")]


class Running:
    """A run of the command line that was started; ``wait`` for its end. ``inside`` is called in its process first."""

    def __init__(self, command: list[str], work: Path, inside: Callable[[], object] | None = None):
        work.mkdir(parents=True, exist_ok=True)
        self.work, self._began = work, time.monotonic()
        (work / "counts").write_text("")
        sys.stdout.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _child(command, work, inside)

    def wait(self, seconds: float | None = None) -> Ended | None:
        """How it ended; None where it has not after ``seconds``."""
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            pid, code = os.waitpid(self.pid, 0 if end is None else os.WNOHANG)
            if pid:
                return self._ended(os.waitstatus_to_exitcode(code))
            if end is not None and time.monotonic() >= end:
                return None
            time.sleep(0.001)

    def kill(self, number: int = signal.SIGKILL) -> Ended:
        """Send a signal, and wait for the end."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, number)
        ended = self.wait()
        assert ended is not None
        return ended

    def _ended(self, status: int) -> Ended:
        out, err = ((self.work / name).read_text(errors="replace") for name in ("out", "err"))
        ended = Ended(status, time.monotonic() - self._began, out, err)
        for line in (self.work / "counts").read_text().splitlines():
            what, number = line.split()
            getattr(ended, what).append(int(number))
        return ended


def run(command: list[str], work: Path, inside: Callable[[], object] | None = None) -> Ended:
    """A run to its end."""
    ended = Running(command, work, inside).wait()
    assert ended is not None
    return ended


def _child(command: list[str], work: Path, inside: Callable[[], object] | None) -> NoReturn:
    code = 1
    try:
        for number, name in ((1, "out"), (2, "err")):
            file = os.open(work / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
            os.close(file)
        sys.stdout, sys.stderr = (os.fdopen(n, "w", encoding="utf-8", errors="backslashreplace") for n in (1, 2))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _count(work / "counts")
        if inside is not None:
            inside()
        from plenopiv.cli import main

        try:
            code = main(command)
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _count(path: Path) -> None:
    """Note in a file, line by line, what is begun."""
    from plenopiv.run import pair, shown

    def noted(what: str, function: Any, number: int) -> Any:
        def counted(*given: Any) -> Any:
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
            os.write(descriptor, f"{what} {given[number]}\n".encode())
            os.close(descriptor)
            return function(*given)

        return counted

    pair.reconstructed = noted("frames", pair.reconstructed, 2)  # type: ignore[attr-defined]
    shown.reconstructed = noted("shown", shown.reconstructed, 2)  # type: ignore[attr-defined]
    pair.Job.pair = noted("pairs", pair.Job.pair, 1)  # type: ignore[method-assign]


@dataclass
class Series:
    """A recording of ``pairs`` pairs in ``folder``, its results in ``folder/recording/results``, and what an
    undisturbed run leaves there (``wanted``), in so many seconds."""

    folder: Path
    wanted: dict[str, bytes]
    seconds: float
    pairs: int
    _with_volumes: Series | None = None

    @classmethod
    def made(cls, folder: Path, pairs: int) -> Series:
        """Simulated, and measured twice: the first run may compile."""
        load()
        in_a_child(lambda: make_recording(folder / "recording", pairs))
        return cls(folder, {}, 0.0, pairs).measured(2)

    def with_volumes(self) -> Series:
        """The same recording in a folder of its own, of which the volumes are kept (output.volumes = true)."""
        if self._with_volumes is None:
            folder = self.folder.with_name(f"{self.folder.name}-volumes")
            shutil.copytree(self.results.parent, folder / "recording", ignore=shutil.ignore_patterns("results"))
            file = folder / "recording" / "experiment.toml"
            file.write_text(file.read_text().replace("volumes = false", "volumes = true"))
            self._with_volumes = Series(folder, {}, 0.0, self.pairs).measured(1)
            if not any(name.startswith("volume-") for name in self._with_volumes.wanted):
                raise RuntimeError("no volumes were kept")
        return self._with_volumes

    def measured(self, times: int) -> Series:
        """This, with what an undisturbed run leaves, and the seconds of the last one."""
        pairs, series = self.pairs, self
        for _ in range(times):
            series.clear()
            ended = series.run()
            if ended.status not in (0, 3) or sorted(ended.frames) != list(range(2 * pairs)):
                raise RuntimeError(f"the undisturbed run: {ended}")
            series.wanted, series.seconds = contents(series.results), ended.seconds
        return series

    @property
    def results(self) -> Path:
        """Its results folder."""
        return self.folder / "recording" / "results"

    @property
    def command(self) -> list[str]:
        """That measures it."""
        return ["run", str(self.folder / "recording" / "experiment.toml")]

    def clear(self, whole: bool = False) -> None:
        """Remove its results; ``whole``: have those of the undisturbed run."""
        shutil.rmtree(self.results, ignore_errors=True)
        for name, content in self.wanted.items() if whole else ():
            (self.results / name).parent.mkdir(parents=True, exist_ok=True)
            (self.results / name).write_bytes(content)

    def start(self, inside: Callable[[], object] | None = None, *more: str) -> Running:
        """A run of it."""
        return Running([*self.command, *more], self.folder / "process", inside)

    def run(self, inside: Callable[[], object] | None = None, *more: str) -> Ended:
        """A run of it to the end."""
        ended = self.start(inside, *more).wait()
        assert ended is not None
        return ended

    def finished(self) -> set[int]:
        """Numbers of the pairs that a stopped run has kept."""
        return {int(path.stem[-4:]) for path in (self.results / ".plenopiv" / "pairs").glob("*.json")}

    def wrong(self, ended: Ended) -> list[str]:
        """What is not as after an undisturbed run."""
        why = [] if ended.status in (0, 3) else [f"status {ended.status}: {ended.err[-600:]}"]
        why += [f"stderr: {line[:300]}" for line in ended.odd[:2]]
        other = differences(contents(self.results), self.wanted)
        return why + ([f"other files: {' '.join(other[:8])}"] if other else [])


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, those without a place among results too."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def differences(found: Mapping[str, bytes], wanted: Mapping[str, bytes]) -> list[str]:
    """Names of files that are not those of an undisturbed run, but for times, memory, dates and the folder's name."""
    names = sorted(found.keys() | wanted.keys())
    return [name for name in names if _timeless(name, found.get(name)) != _timeless(name, wanted.get(name))]


def _timeless(name: str, content: bytes | None) -> object:
    if content is None or name not in (*OWN_LINES, "manifest.jsonl"):
        return content
    text = content.decode(errors="replace")
    try:
        return _without_times(name, text)
    except ValueError:  # it is damaged
        return content


def _without_times(name: str, text: str) -> object:
    if name == "summary.json":
        return json.dumps({key: value for key, value in json.loads(text).items() if key not in TIMES})
    if name == "manifest.jsonl":
        lines = [json.loads(line) for line in text.splitlines()]
        return [line | {"sha256": "", "check": ""} if line.get("file") in OWN_LINES else line for line in lines]
    text = re.sub(r"<tr>(?:(?!</tr>).)*height=\"4\"(?:(?!</tr>).)*</tr>", "", text, flags=re.DOTALL)  # bars of stages
    text = re.sub(r"<tr><th>(time_estimate_s|machine_speed)</th><td>[^<]*</td></tr>", "", text)  # as it is at present
    text = re.sub(r'(<p class="run">)[^<·]*/', r"\1", text)  # the folder of the experiment, another for each case
    return re.sub(r"\d+(\.\d+)? (s|min|h|GB)\b|\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d)?", "", text)
