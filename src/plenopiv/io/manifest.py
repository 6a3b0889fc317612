"""manifest.jsonl: what a results folder holds, with hashes; a line a finished piece.

The first line says what all depends on, and how many lines follow ({"inputs": ..., "lines": n}); one for each pair
follows ({"pair": k, ...}) with its frames, the files that it wrote and what they hash to; then one for each other file
({"file": name, "sha256": ...}). Each line ends in a hash of itself ("check"), so that a damaged line is known from a
whole one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plenopiv.errors import PlenoPIVError
from plenopiv.io.output import plain

NAME = "manifest.jsonl"
CHECK = 16  # hexadecimal digits
NAMED = 3  # changes that a message names
SETTLED = "calibration", "tiles"  # inputs that are known once calibration and memory are


class Records(MutableMapping[int, dict[str, Any]]):
    """Records of pairs by their number, held as their lines: a third of the memory, where there are thousands."""

    def __init__(self, records: Mapping[int, Mapping[str, Any]] | None = None) -> None:
        self._lines: dict[int, bytes] = {}
        for number, record in (records or {}).items():
            self[number] = dict(record)

    def __getitem__(self, number: int) -> dict[str, Any]:
        record: dict[str, Any] = json.loads(self._lines[number])
        return record

    def __setitem__(self, number: int, record: dict[str, Any]) -> None:
        self._lines[number] = json.dumps(plain(record), allow_nan=False, sort_keys=True).encode()

    def __delitem__(self, number: int) -> None:
        del self._lines[number]

    def __iter__(self) -> Iterator[int]:
        return iter(self._lines)

    def __len__(self) -> int:
        return len(self._lines)


@dataclass
class Manifest:
    """What was read of one; ``damaged``: number of lines that are not whole, or missing."""

    inputs: dict[str, Any] | None = None
    pairs: MutableMapping[int, dict[str, Any]] = field(default_factory=Records)
    files: dict[str, str] = field(default_factory=dict)
    damaged: int = 0

    @classmethod
    def read(cls, path: Path) -> Manifest | None:
        """The manifest of a file; None where there is none."""
        try:
            text = path.read_bytes().decode(errors="replace")
        except OSError:
            return None
        out = cls()
        bad, expected = 0, 0
        for one in text.split("\n")[: -1 if text.endswith("\n") else None]:
            content = whole(one)
            if content is None:
                bad += 1
            elif "inputs" in content:
                out.inputs, expected = content["inputs"], content["lines"]
            elif "pair" in content:
                out.pairs[int(content["pair"])] = content
            elif "file" in content:
                out.files[str(content["file"])] = str(content["sha256"])
        gone = expected - len(out.pairs) - len(out.files) if out.inputs is not None else 1
        out.damaged = max(bad, gone, int(out.text() != text))
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
    """What a line (without its end) holds, without its hash; None where it is not what ``line`` made, byte for byte."""
    try:
        content = json.loads(text)
        del content["check"]
        return content if line(content) == f"{text}\n" else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def whole_file(path: Path) -> dict[str, Any] | None:
    """What a file of one line holds, as ``whole``; None where it is missing too."""
    try:
        return whole(path.read_bytes().decode(errors="replace").removesuffix("\n"))
    except OSError:
        return None


def _hash(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()[:CHECK]


def sha256(path: Path) -> str:
    """Of a file's content.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_of(path: Path) -> str:
    """``sha256`` of a file that was just written.

    Raises:
        PlenoPIVError: it cannot be read.
    """
    try:
        return sha256(path)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None


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


def named_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first ``changes``, for a message; what one of both cannot have yet (``SETTLED``) is left out."""
    yet = {key for key in SETTLED if not (key in before and key in now)}
    was, now = ({key: value for key, value in each.items() if key not in yet} for each in (before, now))
    found = list(changes(was, now))
    more = f", and {len(found) - NAMED} more" if len(found) > NAMED else ""
    return "; ".join(found[:NAMED]) + more


def settled_otherwise(known: Mapping[str, Any], inputs: Mapping[str, Any]) -> str:
    """What of calibration and tiles is not as ``known``, and the ways out, for a message; "" where all is the same.

    ``known`` has the key "digest" alone where nothing but ``digest_of`` is left of it.
    """
    remedy = "use --overwrite, or another output.directory"
    if "digest" in known:
        same = known["digest"] == digest_of(inputs)
        return "" if same else f"another calibration or number of tiles; give the same --memory, {remedy}"
    if not (named := named_changes(known, inputs)):
        return ""
    if known.get("calibration") == inputs.get("calibration"):
        return f"another number of tiles ({named}); give the same --memory, {remedy}"
    return f"another calibration ({named}); {remedy}"


def inputs_of_summary(directory: Path) -> str | None:
    """What ``summary.json`` of a results folder says that the results depend on."""
    try:
        return str(json.loads((directory / "summary.json").read_text(encoding="utf-8"))["inputs_sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
