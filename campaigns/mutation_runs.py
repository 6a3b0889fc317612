"""Tests of a mutant, in a copy of the tree.

The copies lie in a folder outside the repository, one for each mutant that is tried at a time, and only there a file
is ever changed. What is tried: whether the mutated module can be imported, then the nearest tests, then all other quick
ones, up to the first that fails. Each runs in a process group of its own, which ends with the campaign.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import mutants
from mutation_plan import PACKAGE, Mutant, nearest

IMPORT_S = 120.0
# A test that runs for ever ends by itself should the campaign be killed: twice the clock's limit of processor time.
LIMITED = "import resource, runpy, sys; resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[1]),) * 2); "
LIMITED += "sys.argv[1:] = sys.argv[2:]; runpy.run_module('pytest', run_name='__main__', alter_sys=True)"


class RunError(Exception):
    """The tests could not be run at all; one line."""


@dataclass(frozen=True)
class Options:
    """``timeout_s``: of all tests of a mutant; ``test_s``: of one (from pytest 9 on). ``workers``: of pytest-xdist, 0
    without it. ``only_nearest``: the other quick tests are left out."""

    timeout_s: float = 1200.0
    test_s: float = 300.0
    workers: int = 0
    only_nearest: bool = False


@dataclass(frozen=True)
class Outcome:
    """``result``: caught, survived or not viable. ``by``: the test that failed, or timeout, crash, import. ``tests``:
    what was run, nearest or quick; of a caught mutant, what caught it."""

    result: str
    by: str
    tests: str
    seconds: float


@dataclass
class Processes:
    """Process groups that run now; ``stop`` ends them, and none starts afterwards."""

    running: set[int] = field(default_factory=set)
    stopped: bool = False

    def run(
        self, command: list[str], folder: Path, env: dict[str, str], timeout_s: float, lock: int
    ) -> tuple[int, str]:
        """Exit status and output; raises ``subprocess.TimeoutExpired``. A process that outlives this one, because this
        one was killed, holds on to ``lock``."""
        if self.stopped:
            raise KeyboardInterrupt
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            pass_fds=[lock],
        )
        self.running.add(process.pid)
        if self.stopped:  # meanwhile: ``stop`` has not seen it
            _end(process.pid)
        try:
            said, _ = process.communicate(timeout=max(timeout_s, 0.1))
        finally:
            _end(process.pid)  # and what it started
            process.wait()
            self.running.discard(process.pid)
        if self.stopped:
            raise KeyboardInterrupt
        return process.returncode, said

    def stop(self) -> None:
        """End all that runs."""
        self.stopped = True
        for group in list(self.running):
            _end(group)


def _end(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


@contextmanager
def locked(folder: Path) -> Iterator[int]:
    """A folder for one campaign; raises ``RunError`` while another one, or a test of a killed one, works in it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(
                "another campaign is at work in the same folder; wait for it, or give another --work"
            ) from None
        yield lock.fileno()


def tracked(root: Path) -> list[str]:
    """Files that belong to the project, those that Git lists; raises ``RunError`` outside a Git checkout."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=False)
    names = [name for name in listed.stdout.split("\0") if name and (root / name).is_file()]
    if listed.returncode or not names:
        raise RunError("not a Git checkout: the campaign copies the files that Git lists")
    return names


class Tree:
    """A copy of the project's files in ``folder``, in which one mutant at a time is tried; ``cache``: of compiled
    kernels, for all copies."""

    def __init__(self, root: Path, folder: Path, cache: Path, processes: Processes, lock: int, one_thread: bool):
        self.folder, self.processes, self._lock = folder, processes, lock
        shutil.rmtree(folder, ignore_errors=True)
        for name in tracked(root):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, folder / name)
        # Without byte code: a mutant as long as the original, and as old to the second, would run as the original.
        self.env = os.environ | {"PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
        self.env |= {"XDG_CACHE_HOME": str(cache)}
        if one_thread:
            self.env |= {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def check(self) -> None:
        """Raises ``RunError`` unless it is this copy that Python imports."""
        code = "import plenopiv, sys; sys.exit(plenopiv.__file__ != sys.argv[1])"
        imported = str(self.folder / PACKAGE / "__init__.py")
        status, _ = self._run(["-c", code, imported], IMPORT_S)
        if status:
            raise RunError(
                "Python imports PlenoPIV from elsewhere than the copy; start from an environment that has it"
            )

    def unmutated(self, tests: list[str], options: Options) -> Outcome:
        """Some tests, by default the quick ones, of the project as it is; all must pass."""
        began = time.monotonic()
        by = self._tests(tests, options, began + options.timeout_s)
        return Outcome("caught" if by else "survived", by, "quick", time.monotonic() - began)

    def tried(self, mutant: Mutant, options: Options) -> Outcome:
        """The mutant's outcome; the copy is as before afterwards."""
        began, path = time.monotonic(), self.folder / mutant.file
        text = path.read_text(encoding="utf-8")
        times = path.stat()
        try:
            path.write_text(mutants.applied(text, mutant.edit), encoding="utf-8")
            result, by, tests = self._judged(mutant, options, began + options.timeout_s)
        finally:
            path.write_text(text, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return Outcome(result, by, tests, time.monotonic() - began)

    def _judged(self, mutant: Mutant, options: Options, end: float) -> tuple[str, str, str]:
        module = Path(mutant.file).relative_to("src").with_suffix("").as_posix().replace("/", ".")
        try:
            status, _ = self._run(["-c", f"import {module}"], IMPORT_S)
        except subprocess.TimeoutExpired:
            status = 1
        if status:
            return "not viable", "import", "import"
        first = nearest(self.folder, mutant)
        by = self._tests(first, options, end) if first else ""
        if by or options.only_nearest:
            return "caught" if by else "survived", by, "nearest"
        by = self._tests([f"--ignore={folder}" for folder in first], options, end)
        return "caught" if by else "survived", by, "quick"

    def _tests(self, arguments: list[str], options: Options, end: float) -> str:
        """What failed first; empty if nothing did."""
        command = ["-c", LIMITED, str(int(2 * options.timeout_s) + 60)]
        command += ["-m", "not full", "-x", "-rfE", "--tb=no", "-p", "no:cacheprovider"]
        command += ["-o", f"faulthandler_timeout={options.test_s:.0f}", "-o", "faulthandler_exit_on_timeout=true"]
        command += ["-n", str(options.workers)] if options.workers else []
        try:
            status, said = self._run([*command, *arguments], end - time.monotonic())
        except subprocess.TimeoutExpired:
            return "timeout"
        return failed(status, said)

    def _run(self, arguments: list[str], timeout_s: float) -> tuple[int, str]:
        return self.processes.run([sys.executable, *arguments], self.folder, self.env, timeout_s, self._lock)


def failed(status: int, said: str) -> str:
    """The test that failed first, of pytest's exit status and output; empty if all passed. Raises ``RunError`` where
    pytest itself did not run."""
    if status == 0:
        return ""
    named = re.search(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", said, re.MULTILINE)
    if status in (1, 2) and named:
        return named[1]
    if re.search(r"Timeout \(\d+:\d\d:\d\d\)!$", said, re.MULTILINE):
        return "timeout"
    if status < 0 or status > 128:
        return "crash"
    last = [line for line in said.splitlines() if line.strip()][-1:]
    raise RunError(f"pytest did not run (exit status {status}): {' '.join(last)}")
