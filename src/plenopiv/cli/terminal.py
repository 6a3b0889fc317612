"""Output of the program: text for people, JSON lines for batch systems, colours on a terminal only.

With ``--json`` every line on stdout is one JSON object with the key ``event``:

    progress  stage, done, total, elapsed_s, eta_s (null until it is known); at most one a second and stage
    note      message
    warning   message
    error     message, exit_code; the last line
    result    command, text, and what the command adds (files, findings); the last line

With ``--quiet`` progress and notes are left out; warnings, errors and the result stay. Both may stand anywhere.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from plenopiv.errors import printable

LONGEST = 1000  # letters of a line
COLOURS = {"red": "31", "green": "32", "yellow": "33"}


@dataclass(frozen=True)
class Outcome:
    """Result of a command: text, facts for programs, and the exit code."""

    text: str
    facts: dict[str, Any] = field(default_factory=dict)
    exit_code: int = 0


@dataclass
class Terminal:
    """Output of this process, as text or as JSON lines."""

    as_json: bool = False
    quiet: bool = False

    def take_flags(self, arguments: Sequence[str]) -> list[str]:
        """Set ``as_json`` and ``quiet`` from ``--json``, ``--quiet`` and ``-q`` before ``--``; returns the others."""
        end = arguments.index("--") if "--" in arguments else len(arguments)
        flags = [word for word in arguments[:end] if word in ("--json", "--quiet", "-q")]
        self.as_json, self.quiet = "--json" in flags, "--quiet" in flags or "-q" in flags
        return [word for word in arguments[:end] if word not in flags] + list(arguments[end:])

    def event(self, kind: str, **facts: Any) -> None:
        """One JSON line on stdout."""
        _print(json.dumps({"event": kind, **facts}, allow_nan=False))

    def note(self, message: str) -> None:
        """Print a note, one line on stderr."""
        if self.quiet:
            return
        if self.as_json:
            self.event("note", message=message)
        else:
            print(f"plenopiv: {printable(message)}", file=sys.stderr, flush=True)

    def warning(self, message: str) -> None:
        """Print a warning, one line on stderr."""
        line = _one_line(message)
        if self.as_json:
            self.event("warning", message=line)
        else:
            print(f"plenopiv: {coloured('warning:', 'yellow', sys.stderr)} {printable(line)}", file=sys.stderr)

    def error(self, message: str, code: int) -> int:
        """Print an error, one line on stderr; returns the exit code. An event that cannot be written is a line too."""
        line = _one_line(message)
        if self.as_json and sys.stdout is not None:
            try:
                self.event("error", message=line, exit_code=code)
                return code
            except OSError:  # the disk is full, or the reader went away
                sys.stdout = None  # the interpreter would try again at its end
        print(f"plenopiv: {coloured('error:', 'red', sys.stderr)} {printable(line)}", file=sys.stderr)
        return code

    def result(self, command: str, outcome: Outcome | str) -> int:
        """Print the result of a command on stdout; returns its exit code."""
        ended = Outcome(outcome) if isinstance(outcome, str) else outcome
        if self.as_json:
            self.event("result", command=command, text=ended.text, **ended.facts)
        else:
            _print(ended.text)
        return ended.exit_code


def _print(text: str) -> None:
    """Print on stdout at once. Where its disk is full there is no stdout any more: the interpreter would write again at
    its end, and fail with a traceback.

    Raises:
        OSError: it cannot be written.
    """
    try:
        print(text, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        sys.stdout = None
        raise OSError(error.errno, error.strerror, "stdout") from None


def _one_line(message: str) -> str:
    """A message without line ends, and without the end of what a file holds in place of a name or a unit."""
    line = " ".join(message.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."


terminal = Terminal()


def command_line(command: str, *paths: Path) -> str:
    """A command of this program as it is pasted into a POSIX shell, whatever the paths hold."""
    words = [f"./{path}" if str(path).startswith("-") else str(path) for path in paths]
    return " ".join(["plenopiv", command, *map(shlex.quote, words)])


def coloured(text: str, colour: str, stream: TextIO) -> str:
    """Text in colour on a terminal that shows colours, plain elsewhere (https://no-color.org)."""
    if not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or terminal.as_json:
        return text
    return f"\x1b[{COLOURS[colour]}m{text}\x1b[0m"
