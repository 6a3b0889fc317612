"""Reference pages that the program writes itself: commands, types of keys, modules."""

import pkgutil
import re
from typing import Any

from typer.main import get_command
from typer.testing import CliRunner

import plenopiv
from plenopiv.cli import app
from plenopiv.experiment.file import Experiment

WIDTH = "96"  # characters of a line of help
LIMITS = {"exclusiveMinimum": "> {}", "minimum": ">= {}", "exclusiveMaximum": "< {}", "maximum": "<= {}"}


def commands_page() -> str:
    """The help of ``plenopiv`` and of each of its commands."""
    text = ["# Commands\n\nWhat `plenopiv --help` and `plenopiv COMMAND --help` print.\n"]
    for name in ("", *get_command(app).commands):
        words = [name] if name else []
        result = CliRunner().invoke(
            app, [*words, "--help"], prog_name="plenopiv", env={"COLUMNS": WIDTH, "TERMINAL_WIDTH": WIDTH}
        )
        said = re.sub(r"\x1b\[[0-9;]*m", "", result.stdout).rstrip()
        text.append(f"## plenopiv {name}".rstrip() + f"\n\n```text\n{said}\n```\n")
    return "\n".join(text)


def key_types_page() -> str:
    """Type and limits of each key, from the pydantic models that read the file."""
    schema = Experiment.model_json_schema(by_alias=True)
    text = [
        "# Types and limits of the keys\n",
        "From the models that read the file; what each key means is in [every key](experiment-file.md).\n",
    ]
    _tables(schema, schema, "", text)
    return "\n".join(text)


def _tables(schema: dict[str, Any], table: dict[str, Any], name: str, text: list[str]) -> None:
    rows, below = [], []
    for key, field in table["properties"].items():
        inner = _table_of(schema, field)
        if inner is not None:
            below.append((f"{name}.{key}".lstrip("."), inner))
            continue
        required = key in table.get("required", ())
        default = "required" if required else _written(field.get("default"))
        rows.append(f"| `{key}` | {_kind(field)} | {default} |")
    if rows:
        text += [f"## `[{name}]`\n", "| key | type | default |", "|---|---|---|", *rows, ""]
    for dotted, inner in below:
        _tables(schema, inner, dotted, text)


def _table_of(schema: dict[str, Any], field: dict[str, Any]) -> dict[str, Any] | None:
    choices = [field, field.get("items", {}), *field.get("anyOf", ()), *field.get("allOf", ())]
    choices += [choice.get("items", {}) for choice in field.get("anyOf", ())]
    for choice in choices:
        if "$ref" in choice:
            return schema["$defs"][choice["$ref"].rpartition("/")[2]]
    return None


def _written(value: Any) -> str:
    if value is None:
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value!r}`".replace("'", '"')


def _kind(field: dict[str, Any]) -> str:
    """A JSON schema in a few words: "number > 0", "list of 3 of whole number 1 to 1024"."""
    if "anyOf" in field:
        kinds = [_kind(choice) for choice in field["anyOf"] if choice.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "const" in field:
        return f'`"{field["const"]}"`'
    if "enum" in field:
        return ", ".join(f'`"{value}"`' for value in field["enum"])
    kind = field.get("type", "any")
    if isinstance(kind, list):
        return " or ".join(_kind({"type": one}) for one in kind)
    if kind == "array":
        inside = field.get("prefixItems") or [field.get("items", {})]
        count = f" of {field['minItems']}" if field.get("minItems") and field.get("maxItems") else ""
        of = _kind(inside[0]) if inside[0] else ""
        return f"list{count}" + (f": {of}" if of else "")
    word = {"integer": "whole number", "string": "text", "boolean": "true or false", "object": "table"}.get(kind, kind)
    bounds = [LIMITS[name].format(field[name]) for name in LIMITS if name in field]
    return " ".join([word, ", ".join(bounds)]).strip()


def module_pages() -> dict[str, str]:
    """A page for each module or subpackage directly under ``plenopiv``, with all that is in it: path -> text."""
    pages, names = {}, []
    for found in pkgutil.iter_modules(plenopiv.__path__):
        modules = [f"plenopiv.{found.name}"]
        if found.ispkg:
            package = __import__(modules[0], fromlist=["__path__"])
            modules += [m.name for m in pkgutil.walk_packages(package.__path__, f"{modules[0]}.")]
        names.append(found.name)
        text = [f"# plenopiv.{found.name}\n"]
        for module in modules:
            title = f"## {module}\n\n" if module != modules[0] else ""
            text.append(f"{title}```{{eval-rst}}\n.. automodule:: {module}\n```\n")
        pages[f"modules/{found.name}.md"] = "\n".join(text)
    listed = "\n".join(names)
    pages["modules/index.md"] = (
        "# All modules\n\nEvery public function and class, from its docstring. What scripts need is on "
        f"[one page](../api.md).\n\n```{{toctree}}\n\nplenopiv\n{listed}\n```\n"
    )
    pages["modules/plenopiv.md"] = "# plenopiv\n\n```{eval-rst}\n.. automodule:: plenopiv\n```\n"
    return pages
