"""The project's docstrings are plain text that reads well in the code: here they become reStructuredText."""

import re
from typing import Any

SECTIONS = re.compile(r"^\s*(Args|Arguments|Raises|Returns|Yields|Note|Notes|Example|Examples|Attributes):\s*$")
LISTED = re.compile(r"^\s*\S+( \S+)*\s{2,}\S")  # a name, a gap, what it is: lines that are aligned
LITERAL = re.compile(r"(``.+?``)")


def indent(line: str) -> int:
    """Spaces that a line begins with."""
    return len(line) - len(line.lstrip())


def as_rst(lines: list[str]) -> list[str]:
    """Bars are no substitutions, indented and aligned blocks are literal; Google's sections stay as they are."""
    result: list[str] = []
    blocks: list[list[str]] = [[]]
    for line in lines:
        if not line.strip():
            blocks.append([])
        else:
            blocks[-1].append(line)
    in_section = False
    for block in blocks:
        if not block:
            continue
        if SECTIONS.match(block[0]):
            in_section = True
        elif indent(block[0]) == 0:
            in_section = False
        aligned = sum(bool(LISTED.match(line)) for line in block) >= 2
        if not in_section and (indent(block[0]) > 0 or aligned):
            result += ["::", "", *("    " + line for line in block), ""]
        else:
            result += [*("".join(_escaped(part) for part in LITERAL.split(line)) for line in block), ""]
    return result


def _escaped(part: str) -> str:
    return part if part.startswith("``") else re.sub(r"(?<!\\)\|", r"\\|", part)


def process(_app: Any, what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """For Sphinx' event ``autodoc-process-docstring``, before napoleon reads sections."""
    lines[:] = as_rst(lines)
    if what in ("property", "attribute") and lines:
        lines[0] = lines[0].replace(": ", " - ", 1)  # which napoleon would take for a type
