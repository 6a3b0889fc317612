"""The entry point: what goes wrong is one line on stderr and an exit code, never a traceback.

Exit codes: 0 done (perhaps with warnings), 2 an input cannot be used, 130 interrupted, 143 terminated. ``terminal``
prints the lines, as text or as JSON.
"""

from __future__ import annotations

import atexit
import gc
import logging
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn, TextIO

from plenopiv.cli.app import app
from plenopiv.cli.terminal import terminal
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (``sys.argv`` by default) and return its exit code."""
    if arguments is None:
        atexit.register(gc.freeze)  # the interpreter's last collection would look at a million objects that end anyway
    _print_any_text()
    given = terminal.take_flags(list(sys.argv[1:] if arguments is None else arguments))
    with _warnings_in_one_line(), _notes_in_one_line():
        try:
            with _ended_by_signals():
                code = app(args=given or ["--help"], prog_name="plenopiv", standalone_mode=False)
        except PlenoPIVError as error:
            return _fail(str(error))
        except BrokenPipeError:  # the reader of our output went away
            sys.stdout = None
            return 1
        except MemoryError as error:
            return _fail(f"not enough memory ({error or 'out of memory'}); use larger voxels or a smaller volume")
        except OSError as error:
            return _fail(f"{error.filename or 'input or output'}: {error.strerror or error}")
        except KeyboardInterrupt:
            code = 130
        except SystemExit as ended:  # by a signal
            if terminal.as_json and isinstance(ended.code, int) and ended.code > 128:
                terminal.error("terminated", ended.code)
            raise
        except Exception as error:
            usage = getattr(error, "format_message", None)  # a usage error of the command line
            if usage is None:
                raise
            context = getattr(error, "ctx", None)
            return _fail(f"{usage().rstrip('.')}; see {context.command_path if context else 'plenopiv'} --help")
    if code == 130:
        if terminal.as_json:
            return terminal.error("interrupted", code)
        print("plenopiv: interrupted", file=sys.stderr)
    return code if isinstance(code, int) else 0


def _fail(message: str) -> int:
    return terminal.error(message, 2)


def _print_any_text() -> None:
    """Let stdout write letters that its encoding lacks as escapes, as stderr does; work that is done is told."""
    change = getattr(sys.stdout, "reconfigure", None)  # notebooks have streams of their own
    if change is not None:
        change(errors="backslashreplace")


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print a PlenoPIVWarning as one line, once for each text; leave other libraries' warnings as they are."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", PlenoPIVWarning)
        usual, printed = warnings.showwarning, set()

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, PlenoPIVWarning):
                usual(message, category, filename, lineno, file, line)
            elif str(message) not in printed:
                printed.add(str(message))
                terminal.warning(str(message))

        warnings.showwarning = show
        yield


@contextmanager
def _notes_in_one_line() -> Iterator[None]:
    """Print what the package logs (what memory a run takes, say), a line each."""
    log, handler = logging.getLogger("plenopiv"), logging.Handler()
    handler.emit = lambda record: terminal.note(record.getMessage())  # type: ignore[method-assign]
    before = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(before)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack as SIGINT does: half-written files are removed, what is finished is kept.

    A library's own clean-up may fail on the way out (matplotlib's does within a figure); such an error does not hide
    the signal.
    """
    received: list[BaseException] = []

    def stop(number: int, frame: object) -> NoReturn:
        received.append(KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number))
        raise received[-1]

    if threading.current_thread() is not threading.main_thread():  # only there may signals be set
        yield
        return
    ends = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGINT") if hasattr(signal, name)]
    ends = [one for one in ends if signal.getsignal(one) is not signal.SIG_IGN]  # as nohup leaves SIGHUP
    before = [signal.signal(one, stop) for one in ends]
    try:
        yield
    except Exception as error:
        if received:
            raise received[0] from error
        raise
    finally:
        for one, usual in zip(ends, before, strict=True):
            signal.signal(one, usual)
