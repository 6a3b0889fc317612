"""manifest.jsonl: what a results folder holds, with hashes; a line a finished piece.

The first line says what all depends on, and how many lines follow ({"inputs": ..., "lines": n}); one for each pair
follows ({"pair": k, ...}) with its frames, the files that it wrote and what they hash to; then one for each other file
({"file": name, "sha256": ...}). Each line ends in a hash of itself ("check"), so that a damaged line is known from a
whole one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plenopiv.io.output import plain

NAME = "manifest.jsonl"
CHECK = 16  # hexadecimal digits


@dataclass
class Manifest:
    """What was read of one; ``damaged``: number of lines that are not whole, or missing."""

    inputs: dict[str, Any] | None = None
    pairs: dict[int, dict[str, Any]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    damaged: int = 0

    @classmethod
    def read(cls, path: Path) -> Manifest | None:
        """The manifest of a file; None where there is none."""
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return None
        out = cls()
        lines = text.splitlines()
        expected = 0
        for one in lines:
            content = whole(one)
            if content is None:
                continue
            if "inputs" in content:
                out.inputs, expected = content["inputs"], content["lines"] + 1
            elif "pair" in content:
                out.pairs[int(content["pair"])] = content
            elif "file" in content:
                out.files[str(content["file"])] = str(content["sha256"])
        found = len(out.pairs) + len(out.files)
        out.damaged = expected - found - 1 if out.inputs is not None else max(len(lines) - found, 1)
        return out

    def text(self) -> str:
        """As the file holds it."""
        count = len(self.pairs) + len(self.files)
        lines: list[Mapping[str, Any]] = [{"inputs": self.inputs, "lines": count}]
        lines += [self.pairs[k] for k in sorted(self.pairs)]
        lines += [{"file": name, "sha256": self.files[name]} for name in sorted(self.files)]
        return "".join(line(each) for each in lines)


def line(content: Mapping[str, Any]) -> str:
    """A line of a manifest, its end included."""
    body = json.dumps(plain(dict(content)), allow_nan=False, sort_keys=True)
    return f'{body[:-1]}, "check": "{_hash(body)}"}}\n'


def whole(text: str) -> dict[str, Any] | None:
    """What a line holds, without its hash; None where it is damaged."""
    try:
        content = json.loads(text)
        check = content.pop("check")
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return None
    body = json.dumps(content, allow_nan=False, sort_keys=True)
    return content if check == _hash(body) else None


def _hash(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()[:CHECK]


def sha256(path: Path) -> str:
    """Of a file's content.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_whole(path: Path, digest: str) -> bool:
    """Whether a file is there and hashes to ``digest``."""
    try:
        return sha256(path) == digest
    except OSError:
        return False


def digest_of(content: Any) -> str:
    """Hash of what JSON can hold."""
    return hashlib.sha256(json.dumps(plain(content), sort_keys=True).encode()).hexdigest()


def changes(before: Mapping[str, Any], now: Mapping[str, Any], above: str = "") -> Iterable[str]:
    """What differs between two nested tables, as "key: value before, value now"."""
    for key in sorted(before.keys() | now.keys()):
        a, b = before.get(key), now.get(key)
        if a == b:
            continue
        name = f"{above}.{key}" if above else key
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            yield from changes(a, b, name)
        else:
            yield f"{name}: was {_short(a)}, is {_short(b)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
