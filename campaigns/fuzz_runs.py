"""One case: its command in a process of its own, with limits, and what is wrong with how it ended.

Processes are forked off this one, which has loaded the program but run nothing of it: a case takes what its command
takes, and not the second of Python's start. Its peak memory is that of the process as a whole, libraries included.
"""

from __future__ import annotations

import fnmatch
import gc
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from fuzz_cases import WRITTEN, Case, Prepared, prepared

SECONDS, MEMORY = 10.0, 2e9  # of a case: what is asked for
TRIES = 3  # of what takes too long, for which a busy machine may be the reason
DRAWS = 4  # of a case's files
ADDRESSES = 12_000_000_000  # bytes that it may ask for, so that the machine outlives it
ERROR, LONGEST = "plenopiv: error: ", 1200  # letters of a line
PLACE = re.compile(r"\b[a-z_]+(?:\[\d+\])?(?:\.[a-z_]+|: )|\bmemory\b|--z")  # a key, or what a message begins with


@dataclass(frozen=True)
class Outcome:
    """``result``: read, refused or failed; ``why``: of the failed ones, in words. ``memory_gb``: the largest."""

    result: str
    why: str
    seconds: float
    memory_gb: float
    said: str


def load() -> None:
    """Load all that cases use, with one compute thread: a process that has several cannot be forked."""
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TIFFFILE_NUM_THREADS"):
        os.environ[name] = "1"
    import h5netcdf  # noqa: F401
    import imagecodecs  # noqa: F401
    import scipy.interpolate  # noqa: F401
    import tifffile  # noqa: F401
    import xarray  # noqa: F401

    import plenopiv.checks
    import plenopiv.cli.calibrate
    import plenopiv.cli.export
    import plenopiv.cli.info
    import plenopiv.cli.init
    import plenopiv.cli.light_field
    import plenopiv.cli.simulate
    import plenopiv.io
    import plenopiv.report.check
    import plenopiv.report.light_field
    import plenopiv.run.light_field_images  # noqa: F401


def warm(corpus: Path, work: Path) -> None:
    """Run commands on whole files, so that compiled kernels are loaded; nothing that uses HDF5."""
    from plenopiv.cli import main

    out = work / "warm"
    shutil.copytree(corpus / "draft", out)
    (out / "flow.toml").write_text(
        (corpus / "rec" / "experiment.toml").read_text() + '[simulation]\nflow = "uniform"\n'
    )
    for command in (["check", out / "experiment.toml"], ["simulate", out / "flow.toml", out / "made"]):
        with redirect_stdout(io.StringIO()):
            if main(["--quiet", *map(str, command)]):
                raise RuntimeError(f"{command[0]} fails on whole files")
    gc.collect()
    gc.freeze()  # what is loaded is not looked through, and so not copied, in every case


def tried(case: Case, corpus: Path, work: Path) -> Outcome:
    """What became of a case; ``work`` is emptied afterwards."""
    for _ in range(TRIES):
        outcome = _tried_once(case, corpus, work)
        if outcome.seconds <= SECONDS:
            break
    return outcome


def _tried_once(case: Case, corpus: Path, work: Path) -> Outcome:
    folder, temporary = work / "case", work / "temporary"
    for path in (folder, temporary):
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
    case_of = write(case, corpus, folder)
    before = contents(folder)
    status, seconds, memory = _run(case_of.command, folder, temporary, work)
    out, err = ((work / name).read_text(errors="replace") for name in ("out", "err"))
    changes = [f"changed {n}" for n, data in contents(folder).items() if n in before and before[n] != data]
    changes += [f"left {name}" for name in contents(folder) if name not in before]
    changes += [f"removed {name}" for name in before if not (folder / name).exists()]
    left = [path.name for path in temporary.iterdir()]
    why = wrong(case_of, status, seconds, memory, out, err, changes, left)
    result = "failed" if why else "refused" if status == 2 else "read"
    for path in (folder, temporary):
        shutil.rmtree(path, ignore_errors=True)
    return Outcome(result, "; ".join(why), seconds, memory / 1e9, (err or out)[-2000:])


def write(case: Case, corpus: Path, folder: Path) -> Prepared:
    """Write a case's files, in a process of its own: what HDF5 keeps of them is not to be in the command's.

    Raises ``RuntimeError`` where that fails, which is a mistake of the fuzzer.
    """
    for draw in range(DRAWS):
        told = in_a_child(lambda draw=draw: _written(prepared(case, corpus, draw), folder))
        if told:
            spoilt, command = json.loads(told)
            return Prepared({}, spoilt, command)
    raise RuntimeError(f"{case.name}: its files could not be made")


def _written(made: Prepared, folder: Path) -> bytes:
    for name, data in made.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return json.dumps([made.spoilt, made.command]).encode()


def in_a_child(function: Callable[[], bytes]) -> bytes:
    """What a function returns in a process of its own; b"" where that ends otherwise."""
    receiver, sender = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.write(sender, function())
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        told = pipe.read()
    os.waitpid(pid, 0)
    return told


def contents(folder: Path) -> dict[str, bytes | None]:
    """Files and folders below ``folder``, by name."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def wrong(
    case: Prepared,
    status: int | None,
    seconds: float,
    memory: float,
    out: str,
    err: str,
    changes: list[str],
    left: list[str],
) -> list[str]:
    """What a command must not do, of what it did; ``status`` None: it was ended for time or memory."""
    command, lines, why = case.command[0], err.splitlines(), []
    if seconds > SECONDS:
        why.append(f"took longer than {SECONDS:.0f} s")
    if memory > MEMORY:
        why.append(f"took more than {MEMORY / 1e9:.0f} GB")
    if status is None:
        return why
    verdict = command == "check" and status == 2 and "not usable as it is" in out
    if status not in (0, 2):
        why.append(f"ended by signal {-status}" if status < 0 else f"exit status {status}")
    if "Traceback" in err + out:
        why.append(f"traceback: {lines[-1][:200] if lines else ''}")
    odd = [line for line in lines if not line.startswith("plenopiv: ")]
    if odd and "Traceback" not in err:
        why.append(f"stderr: {odd[0][:200]}")
    errors = [line for line in lines if line.startswith(ERROR)]
    if len(errors) != (status == 2 and not verdict):
        why.append(f"{len(errors)} lines of error with exit status {status}")
    if errors and not (Path(case.spoilt).name in errors[0] or PLACE.search(errors[0][len(ERROR) :])):
        why.append(f"names no file or key: {errors[0][:200]}")
    why += [f"a line of {len(line)} letters" for line in lines if len(line) > LONGEST][:1]
    may = WRITTEN[command] if status == 0 or verdict else ()
    not_allowed = [c for c in changes if not any(fnmatch.fnmatch(c.split(" ", 1)[1], pattern) for pattern in may)]
    hidden = [c for c in changes if ".part" in c or "/." in c]
    why += [*dict.fromkeys(not_allowed + hidden)][:3]
    return why + [f"left {name} among temporary files" for name in left[:2]]


def _run(command: list[str], folder: Path, temporary: Path, work: Path) -> tuple[int | None, float, float]:
    """Exit status (negative: the signal; None: ended here), seconds, and the largest memory in bytes."""
    receiver, sender = os.pipe()
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.close(receiver)
        _child(command, folder, temporary, work, lambda: os.write(sender, str(_peak(os.getpid())).encode()))
    os.close(sender)
    peak, status = 0.0, None
    while True:
        ended, code = os.waitpid(pid, os.WNOHANG)
        seconds = time.monotonic() - began
        if ended:
            status = os.waitstatus_to_exitcode(code)
            break
        peak = max(peak, _peak(pid))
        if seconds > SECONDS or peak > MEMORY:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            break
        time.sleep(0.002 if seconds < 0.2 else 0.02)
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # what it may have started
    told = os.read(receiver, 100)
    os.close(receiver)
    return status, seconds, max(peak, float(told or 0))


def _peak(pid: int) -> float:
    """Largest memory of a process so far, bytes; 0 once it has ended."""
    with suppress(OSError, StopIteration, ValueError):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return 1024.0 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
    return 0.0


def _child(command: list[str], folder: Path, temporary: Path, work: Path, tell: Callable[[], object]) -> NoReturn:
    """The command line, as ``plenopiv`` runs it, and the end of the process."""
    code = 1
    try:
        os.setsid()
        for number, name in ((1, "out"), (2, "err")):
            file = os.open(work / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
            os.close(file)
        sys.stdout, sys.stderr = (os.fdopen(n, "w", encoding="utf-8", errors="backslashreplace") for n in (1, 2))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.chdir(folder)
        os.environ["TMPDIR"] = str(temporary)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        from plenopiv.cli import main

        try:
            code = main(command)
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except BaseException:
            traceback.print_exc()
        gc.collect()  # what is left of files and sockets says so now, as it does when Python ends
        sys.stdout.flush()
        sys.stderr.flush()
        tell()
    finally:
        os._exit(code)
