"""Damages to finished results: bytes flipped, files truncated or removed, lines taken out of the manifest.

The next run must find every one, compute only what is damaged, and leave the results of an undisturbed run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from series_runs import SEED, Series

MOST = 4  # damages at a time
REFUSED = ("manifest.jsonl: is damaged, and nothing says", "holds a complete run; use --overwrite")
WAYS = ("flipped", "truncated", "removed", "line")


def tried(series: Series, number: int, most: int = MOST) -> dict[str, Any]:
    """Some files of finished results damaged at once, and the next run."""
    rng = np.random.default_rng([SEED, 3, number])
    series.clear(whole=True)
    manifest, many = "manifest.jsonl", int(rng.integers(1, most + 1))
    names = [str(name) for name in rng.permutation(sorted(series.wanted))[:many]]
    if rng.random() < 0.3 and manifest not in names:
        names[-1] = manifest
    done = [f"{name}: {_damage(series.results / name, rng)}" for name in names]
    lines, lost = _lines_left(series), _lost(series, names)
    told = [name for name in names if name == manifest or any(f'"{name}": '.encode() in line for line in lines)]
    told += [name for name in names if any(f'"file": "{name}"'.encode() in line for line in lines)]
    ended = series.run()
    refused = ended.status == 2 and any(words in ended.err for words in REFUSED)
    if refused:  # neither a line of the manifest nor the summary says what the results are made of
        ended = series.run(None, "--overwrite")
        told, lost = [], list(range(series.pairs))
    why = series.wrong(ended)
    why += [f"{name} was not found" for name in told if f"/{name}: " not in ended.err]
    if sorted(ended.pairs) != sorted(lost):
        why.append(f"pairs {ended.pairs} measured again, damaged were {lost}")
    done = [f"{one} (refused)" if refused else one for one in done]
    return {"damages": done, "pairs": len(ended.pairs), "why": why}


def _damage(path: Path, rng: np.random.Generator) -> str:
    content = path.read_bytes()
    way = str(rng.choice(WAYS if path.name == "manifest.jsonl" else WAYS[:3]))
    if way == "removed":
        path.unlink()
    elif way == "truncated":
        length = int(rng.integers(len(content)))
        path.write_bytes(content[:length])
        way += f" to {length} of {len(content)} bytes"
    elif way == "line":
        lines = content.splitlines(keepends=True)
        at = int(rng.integers(len(lines)))
        path.write_bytes(b"".join(lines[:at] + lines[at + 1 :]))
        way = f"line {at} removed"
    else:
        spoilt, count = bytearray(content), int(rng.integers(1, 9))
        places = rng.integers(len(content), size=count)
        for at in places:
            spoilt[at] ^= int(rng.integers(1, 256))
        if bytes(spoilt) == content:
            spoilt[0] ^= 1
        path.write_bytes(bytes(spoilt))
        way = f"{count} bytes flipped, the first at {places[0]}"
    return way


def _lines_left(series: Series) -> set[bytes]:
    """Lines of the manifest that are whole; of what these do not list, damage is told by the manifest's own."""
    whole, path = series.wanted["manifest.jsonl"].split(b"\n"), series.results / "manifest.jsonl"
    return set(whole) & set(path.read_bytes().split(b"\n")[:-1] if path.exists() else ())


def _lost(series: Series, names: list[str]) -> list[int]:
    """Pairs whose file or line of the manifest is no longer whole."""
    whole, left = series.wanted["manifest.jsonl"].split(b"\n"), _lines_left(series)
    pairs = {number for number in range(series.pairs) if whole[1 + number] not in left}
    files = {int(name[-7:-3]) for name in names if name.startswith("pairs/")}
    return sorted(pairs | files)
