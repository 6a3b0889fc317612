"""Tables of a TOML or JSON file that a person, or chance, wrote: whatever it holds, what is wrong is one line."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from plenopiv.errors import PlenoPIVError, brief, printable

WAY_OUT_OF_COMMAS = "; decimals take a point: 0.5, not 0,5"
COMMA = re.compile(r"[=:\[]\s*[-+]?\d+,\d+(?!\s*[],\d])")  # a number with a decimal comma; not a list
PLACE = re.compile(r"\(at line (\d+), column \d+\)")
LARGEST = 8_000_000  # bytes: the names of 100,000 frames take less
DEEPEST = 16  # tables and lists within one another
MOST_BITS = 64  # of a whole number, as in TOML itself
# A key of many parts takes tomllib memory in proportion to the square of their number.
MANY_PARTS = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""")


def tables(content: bytes, path: Path, as_json: bool = False) -> dict[str, Any]:
    """Nested tables of a file's ``content``, UTF-8.

    Raises:
        PlenoPIVError: one line that begins with ``path``: too large, no text, no TOML or JSON, nested deeper than
            any of the program's files, or whole numbers that no key takes.
    """
    if len(content) > LARGEST:
        raise PlenoPIVError(f"{path}: is larger than {LARGEST // 1_000_000} MB, so it is no file of settings")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PlenoPIVError(f"{path}: is not a text file in UTF-8; {_way_to_text(content, error.start)}") from None
    kind = "neither valid JSON nor TOML" if as_json else "not valid TOML"
    if not as_json and MANY_PARTS.search(text):
        raise PlenoPIVError(f"{path}: holds a key of more than 32 parts between dots; no table is that deep")
    try:
        found = json.loads(text) if as_json else tomllib.loads(text)
    except RecursionError:
        raise PlenoPIVError(f"{path}: is nested too deeply; no key takes lists within lists like that") from None
    except (json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        raise PlenoPIVError(f"{path}: is {kind}: {' '.join(str(error).split())[:200]}{_line(text, error)}") from None
    except (ValueError, OverflowError) as error:  # a number of thousands of digits, a date that is none
        raise PlenoPIVError(f"{path}: holds a value that cannot be read ({brief(error)})") from None
    if not isinstance(found, dict):
        raise PlenoPIVError(f"{path}: must hold tables, not {type(found).__name__}")
    _check(found, path)
    return found


def _way_to_text(content: bytes, at: int) -> str:
    """What to do with a file whose byte ``at`` is of no text in UTF-8."""
    if b"\0" in content[:64]:
        return "name a text file, or save it as UTF-8"
    return f"save it as UTF-8, or write line {content[:at].count(10) + 1} without that character"


def _line(text: str, error: json.JSONDecodeError | tomllib.TOMLDecodeError) -> str:
    """The line of a file's ``text`` that cannot be read, as it names the key, and what is often wrong of it."""
    found = PLACE.search(str(error))
    number = error.lineno if isinstance(error, json.JSONDecodeError) else int(found[1]) if found else 0
    lines = text.split("\n")
    if not 1 <= number <= len(lines) or not (line := printable(lines[number - 1].strip())):
        return ""
    return f": {line[:60]}{WAY_OUT_OF_COMMAS if COMMA.search(line) else ''}"


def _check(found: dict[str, Any], path: Path) -> None:
    """Raise PlenoPIVError where what was read is nested too deeply for Python to print, or holds huge numbers."""
    left: list[tuple[str, int, Any]] = [("", 0, found)]
    while left:
        key, depth, value = left.pop()
        if depth > DEEPEST:
            raise PlenoPIVError(f"{path}: {key[:60]}: is nested more than {DEEPEST} deep; no key takes that")
        if isinstance(value, dict):
            left += [(f"{key}.{name[:60]}".lstrip("."), depth + 1, item) for name, item in value.items()]
        elif isinstance(value, list):
            left += [(key, depth + 1, item) for item in value]
        elif isinstance(value, int) and value.bit_length() > MOST_BITS:
            raise PlenoPIVError(f"{path}: {key[:60]}: is a whole number of {value.bit_length()} bits; is it damaged?")
