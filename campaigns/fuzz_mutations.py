"""How files are spoilt: bytes, text, tables of settings. Each takes a random generator of its own and the content."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from copy import deepcopy
from random import Random
from typing import Any

Change = Callable[[Random, bytes], bytes]

NUMBERS = [
    "0", "-0.0", "-1", "1", "2", "0.5", "1e-30", "1e-9", "1e30", "-1e30", "1e308", "1e400", "5e-324", "nan", "inf",
    "-inf", "25000", "65535", "65536", "4294967295", "4294967296", "-2147483648", "9223372036854775807",
    "18446744073709551616", "1" * 400, "7" * 5000, "0x7fffffff", "1_000", "1e", "--3", "1.2.3", "0" * 300 + "1",
]  # fmt: skip
TEXTS = [
    "", " ", "a\0b", "\0", "\n", "a\nb", "\x1b[31m", "ü", "粒子", "\u202eabc", "\U0001f600", "../../../etc/hostname",
    "/", "/dev/null", ".", "..", "*", "**/*", "[", "{a,b}", "%s%n", "a" * 300, "b" * 70000, "none", "upright", "m",
    "50 mm", "\udcff", "C:\\a", "~", "-x", "--help", "'", '"', "frames.h5::", "::", "x.h5::/a/b",
]  # fmt: skip
VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 3, 0.5, -0.0, 1e30, -1e30, 1e-30, 1e308, 5e-324, float("nan"), float("inf"),
    -float("inf"), 25000, 65535, 65536, 2**31, 2**63, 2**64, 10**400, 10**4000, "", "60", "text", [], {}, [[]], [1],
    [1, 2], [2, 1], [1, 2, 3], [1e30, -1e30], [float("nan")] * 2, [None], ["a", "a"], {"a": 1}, [[1, 2], [3, 4]],
]  # fmt: skip
NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


# --- bytes -----------------------------------------------------------------------------------------------------------


def flip_bits(rng: Random, data: bytes) -> bytes:
    """Some bits, most of them near the beginning, where headers are."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16, 64))):
        if out:
            at = rng.randrange(min(len(out), 512) if rng.random() < 0.6 else len(out))
            out[at] ^= 1 << rng.randrange(8)
    return bytes(out)


def overwrite(rng: Random, data: bytes) -> bytes:
    """A stretch of zeros, ones, or anything."""
    out, size = bytearray(data), rng.choice((1, 2, 4, 8, 64, 1000))
    at = rng.randrange(max(1, len(out)))
    out[at : at + size] = rng.choice((b"\0" * size, b"\xff" * size, rng.randbytes(size), b" " * size))
    return bytes(out)


def truncate(rng: Random, data: bytes) -> bytes:
    """Its beginning."""
    return data[: rng.choice((0, 1, 4, 8, 9, rng.randrange(len(data) + 1), int(0.9 * len(data)), len(data) - 1))]


def cut(rng: Random, data: bytes) -> bytes:
    """Without a stretch in the middle."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.choice((1, 2, 8, 100, 5000)) :]


def repeat(rng: Random, data: bytes) -> bytes:
    """A stretch of it twice, or many times."""
    at = rng.randrange(len(data) + 1)
    size = rng.choice((1, 10, 200, 3000))
    return data[:at] + data[at : at + size] * rng.choice((2, 2, 10, 300)) + data[at + size :]


def splice(rng: Random, data: bytes) -> bytes:
    """Its beginning and its end exchanged, or its end moved to another place."""
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return rng.choice((data[a:] + data[:a], data[:a] + data[b:] + data[a:b]))


def insert(rng: Random, data: bytes) -> bytes:
    """Something in the middle of it: blanks, zeros, chance."""
    at = rng.randrange(len(data) + 1)
    more = rng.choice(
        (b" " * 200_000, b"\n" * 200_000, b"\0" * 5000, rng.randbytes(50), b"\t \r" * 50_000, b"[" * 3000)
    )
    return data[:at] + more + data[at:]


def move_addresses(rng: Random, data: bytes) -> bytes:
    """Eight bytes that may be an address in the file set to another place of it: links that lead round in circles."""
    out = bytearray(data)
    places = [at for at in range(0, len(out) - 8, 8) if 8 <= int.from_bytes(out[at : at + 8], "little") < len(out)]
    for _ in range(rng.choice((1, 1, 2, 8))):
        if places:
            at, other = rng.choice(places), rng.choice(places)
            target = rng.choice((bytes(out[other : other + 8]), rng.randrange(len(out)).to_bytes(8, "little")))
            out[at : at + 8] = rng.choice((target, at.to_bytes(8, "little")))
    return bytes(out)


BYTES: list[Change] = [flip_bits, flip_bits, overwrite, truncate, cut, repeat, splice, insert]


# --- text ------------------------------------------------------------------------------------------------------------


def replace_number(rng: Random, data: bytes) -> bytes:
    """A number of the text by an extreme one, or by none."""
    found = list(NUMBER.finditer(data[:20000]))
    if not found:
        return data
    match = rng.choice(found)
    new = rng.choice([*NUMBERS, "true", '"60"', "[]", "{}", "''"]).encode()
    return data[: match.start()] + new + data[match.end() :]


def change_line(rng: Random, data: bytes) -> bytes:
    """A line twice, gone, elsewhere, or joined with the next."""
    lines = data.split(b"\n")
    k, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(4)
    if what == 0:
        lines.insert(to, lines[k])
    elif what == 1:
        del lines[k]
    elif what == 2:
        lines[k], lines[to] = lines[to], lines[k]
    elif k + 1 < len(lines):
        lines[k : k + 2] = [lines[k] + lines[k + 1]]
    return b"\n".join(lines)


def change_word(rng: Random, data: bytes) -> bytes:
    """A word by another of the same text, or by odd text."""
    words = list(re.finditer(rb"[\w./-]+", data[:20000]))
    if not words:
        return data
    match, other = rng.choice(words), rng.choice(words)
    odd = rng.choice(TEXTS).encode("utf-8", "surrogatepass")
    return data[: match.start()] + rng.choice((other[0], other[0], odd)) + data[match.end() :]


def change_encoding(rng: Random, data: bytes) -> bytes:
    """The same text in another encoding, with other line ends, or that says it were in one."""
    text = data.decode("latin-1")
    return rng.choice(
        (
            text.encode("utf-16"),
            b"\xef\xbb\xbf" + data,
            data.replace(b"\n", b"\r\n"),
            data.replace(b"\n", b"\r"),
            data.replace(b"e", "é".encode("latin-1")),
            data.replace(
                b'version="1.0"', b'version="1.0" encoding="%s"' % rng.choice((b"x", b"utf-16", b"EBCDIC-US"))
            ),
        )
    )


def nest(rng: Random, data: bytes) -> bytes:
    """Brackets within brackets in place of a number, some or thousands of them."""
    found = list(NUMBER.finditer(data[:20000]))
    depth = rng.choice((3, 30, 400, 3000, 100_000))
    opened, closed = rng.choice(
        ((b"[", b"]"), (b"[", b""), (b'{"a":', b"}"), (b"{a=", b"}"), (b"<a>", b"</a>"), (b"a.", b""))
    )
    if opened == b"a.":
        at = rng.choice([0, *(m.end() for m in re.finditer(rb"\n", data[:20000]))])
        return data[:at] + opened * depth + b"a = 1\n" + data[at:]
    match = rng.choice(found) if found else None
    at, end = (match.start(), match.end()) if match else (len(data), len(data))
    return data[:at] + opened * depth + b"1" + closed * depth + data[end:]


TEXT: list[Change] = [change_encoding, nest, *3 * [replace_number], *2 * [change_line], *2 * [change_word]]


# --- tables ----------------------------------------------------------------------------------------------------------


def change_tables(rng: Random, tables: dict[str, Any]) -> dict[str, Any]:
    """A copy with keys removed, renamed, moved, or of odd values."""
    out = deepcopy(tables)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        place = _some_place(rng, out)
        if place is None:
            continue
        holder, key = place
        what = rng.randrange(8)
        if what == 0:
            del holder[key]
        elif what == 1 and isinstance(holder, dict):
            holder[rng.choice([f"{key}s", key[::-1], key.upper(), rng.choice(TEXTS)[:100]])] = holder.pop(key)
        elif what == 2 and (other := _some_place(rng, out)) is not None:
            holder[key] = deepcopy(other[0][other[1]])
        elif what == 3 and isinstance(holder[key], int | float) and abs(holder[key]) < 1e100:
            holder[key] *= rng.choice((-1, 0, 1000, 1e-3, 1e-9, 25000, 1e12, 2))
        elif what == 4 and isinstance(holder[key], str):
            holder[key] = rng.choice(TEXTS)
        else:
            holder[key] = deepcopy(rng.choice(VALUES))
    return out


def _some_place(rng: Random, tables: Any) -> tuple[Any, Any] | None:
    """A dictionary or list within the tables, and a key of it."""
    here = tables
    while True:
        keys = list(here) if isinstance(here, dict) else range(len(here))
        if not keys:
            return None
        key = rng.choice(keys)
        if isinstance(here[key], dict | list) and here[key] and rng.random() < 0.85:
            here = here[key]
        else:
            return here, key


def as_json(tables: Any) -> bytes:
    """JSON, numbers that are none too."""
    return json.dumps(tables, indent=1, default=str).encode("utf-8", "surrogatepass")


def as_toml(tables: dict[str, Any]) -> bytes:
    """TOML as far as it goes: what has no form in it is written as JSON has it."""
    lines = []

    def value(item: Any) -> str:
        if isinstance(item, dict):
            return "{" + ", ".join(f"{json.dumps(str(k))} = {value(v)}" for k, v in item.items()) + "}"
        if isinstance(item, list | tuple):
            return "[" + ", ".join(map(value, item)) + "]"
        if isinstance(item, int) and not isinstance(item, bool) and abs(item) > 10**4000:
            return "9" * 5000
        return {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf"}.get(text := json.dumps(item, default=str), text)

    def table(name: str, keys: dict[str, Any]) -> None:
        plain = {k: v for k, v in keys.items() if not isinstance(v, dict)}
        if name:
            lines.append(f"[{name}]")
        lines.extend(f"{json.dumps(str(k))} = {value(v)}" for k, v in plain.items())
        for key, item in keys.items():
            if isinstance(item, dict):
                table(f"{name}.{json.dumps(str(key))}".lstrip("."), item)

    table("", tables)
    return "\n".join(lines).encode("utf-8", "surrogatepass")
