"""Mutants of Python sources: single spots that can be wrong, found in the syntax tree and changed in the text.

Four kinds, the mistakes that numerical code invites:

    sign         + and -, unary minus, += and -=
    constant     0 and 1 exchanged; another number times 1.5, a small integer plus 1
    comparison   < and <=, < and >, == and != ...
    axis order   axis=0 and 1, subscripts exchanged, x for y in a name that comes in both, .T left out

Left alone: docstrings, annotations, decorators, messages of errors and warnings, f-strings, ``if TYPE_CHECKING``.

A mutant is named by file, enclosing function, kind, and its number among those of that kind in the function, so that
its name outlives changes elsewhere in the file.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from functools import cache

from spot_finder import Edit, find

KINDS = ("sign", "constant", "comparison", "axis order")


@dataclass(frozen=True)
class Spot:
    """A place of one ``kind`` in ``function`` (qualified name, or "module") that ``edit`` changes; ``lines``: the first
    and the last one of that function, or of the statement outside any."""

    function: str
    kind: str
    number: int
    edit: Edit
    lines: tuple[int, int]


@cache
def spots(text: str) -> tuple[Spot, ...]:
    """All spots of a Python source, in the order of the text; of several edits of one spot a hash takes one."""
    found, numbers = [], Counter[tuple[str, str]]()
    for function, kind, edits, lines in sorted(find(text), key=lambda f: (f[2][0].start, f[2][0].end)):
        number = numbers[function, kind]
        numbers[function, kind] += 1
        which = int(digest(f"{function}:{kind}:{number}"), 16) % len(edits)
        found.append(Spot(function, kind, number, edits[which], lines))
    return tuple(found)


def digest(text: str) -> str:
    """A short hash."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def applied(text: str, edit: Edit) -> str:
    """The text after an edit."""
    return text[: edit.start] + edit.new + text[edit.end :]


def function_source(text: str, spot: Spot) -> str:
    """The mutated function, or statement outside any function."""
    return "\n".join(applied(text, spot.edit).split("\n")[spot.lines[0] - 1 : spot.lines[1]])


def changed_line(text: str, edit: Edit) -> tuple[int, str, str]:
    """Number of the first changed line, and it before and after."""
    number = text.count("\n", 0, edit.start)
    before, after = (version.split("\n")[number].strip() for version in (text, applied(text, edit)))
    return number + 1, before, after
