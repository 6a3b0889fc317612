"""What is wrong with an experiment file, in one line that names the file, the key and the way out."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

PLAIN = {
    "tuple_type": "must be a list",
    "too_short": "has too few entries",
    "too_long": "has too many entries",
    "model_type": "must be a table",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text",
    "finite_number": "must be a finite number",
}  # where pydantic's words are about Python
TEXT_OF_NUMBER = re.compile(r"[-+]?\d+([.,]\d+)?")


def tables_of(model: type[BaseModel], prefix: str = "") -> dict[str, list[str]]:
    """Dotted table name -> its keys, for a model and every table below it. The root table is ``""``."""
    tables = {prefix: [field.alias or name for name, field in model.model_fields.items()]}
    for name, field in model.model_fields.items():
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                tables |= tables_of(kind, f"{prefix}.{field.alias or name}".lstrip("."))
    return tables


def unknown_key(dotted: str, tables: dict[str, list[str]]) -> str:
    """``dotted`` is no key: name the nearest right one, in its own table first, then anywhere."""
    table, _, key = dotted.rpartition(".")
    near = get_close_matches(key, tables.get(table, []), n=1, cutoff=0.55)
    if near:
        return f"{dotted}: unknown key; did you mean {near[0]}?"
    everywhere = {f"{t}.{k}".lstrip("."): k for t, keys in tables.items() for k in keys}
    near = get_close_matches(key, list(everywhere.values()), n=1, cutoff=0.7)
    if near:
        place = next(path for path, name in everywhere.items() if name == near[0])
        return f"{dotted}: unknown key; did you mean {place}?"
    return f"{dotted}: unknown key; {f'[{table}]' if table else 'the file'} takes {', '.join(tables.get(table, []))}"


def problems(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """One line for each problem of a file, unknown keys first: they often explain a missing one."""
    tables = tables_of(model)
    unknown, others = [], []
    for item in error.errors(include_url=False):
        dotted = _dotted(item["loc"])
        if item["type"] == "missing" and isinstance(item["loc"][-1], int):
            others.append(f"{_dotted(item['loc'][:-1])}: {PLAIN['too_short']}")
        elif item["type"] == "too_short" and any(line.startswith(f"{dotted}[") for line in others):
            continue  # short only because the entries named above are left out
        elif item["type"] in PLAIN:
            others.append(f"{dotted}: {PLAIN[item['type']]}, not {_short(item['input'])}{_as_number(item)}")
        elif item["type"] == "extra_forbidden":
            unknown.append(unknown_key(dotted, tables))
        elif item["type"] == "missing":
            table, _, key = dotted.rpartition(".")
            is_table = dotted in tables
            others.append(f"{dotted}: missing; add {f'a [{dotted}] table' if is_table else f'{key} to [{table}]'}")
        elif item["type"] == "value_error":
            lines = str(item["ctx"]["error"]).splitlines()
            others += [f"{dotted}: {line}" if dotted else line for line in lines]
        else:
            message = item["msg"].replace("Input should be", "must be")
            others.append(f"{dotted} = {_short(item['input'])}: {message}")
    return unknown + others


def one_line(file: str, lines: list[str]) -> str:
    """The first problem in full, the others by key."""
    more = f" (and {len(lines) - 1} more: {', '.join(line.split(':')[0] for line in lines[1:4])})" if lines[1:] else ""
    return f"{file}: {lines[0]}{more}"


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")


def _as_number(item: Any) -> str:
    """How a number that was written as text is written."""
    text = str(item["input"]).strip()
    if item["type"] not in ("float_type", "int_type") or not TEXT_OF_NUMBER.fullmatch(text):
        return ""
    return f"; write it as {text.replace(',', '.')}, without quotes"


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
