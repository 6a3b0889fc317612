"""docs/api.md names what can be imported, and calls it as it can be called."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "api.md").read_text()
INLINE = re.findall(r"`(plenopiv(?:\.\w+)*)(\([^`]*\))?`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL))
NAMES = sorted({name for name, _ in INLINE})
CALLS = sorted({(name, call.strip("()")) for name, call in INLINE if call})
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def found(dotted):
    """The object of a dotted name: the longest part of it that is a module, then attributes."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[k:]:
            thing = getattr(thing, attribute)
        return thing
    raise ModuleNotFoundError(dotted)


def test_the_page_names_much():
    assert len(NAMES) > 50
    assert len(CALLS) > 30


@pytest.mark.parametrize("name", NAMES)
def test_each_name_imports(name):
    found(name)


@pytest.mark.parametrize(("name", "arguments"), CALLS)
def test_each_call_has_the_arguments_that_there_are(name, arguments):
    """All of them in their order; "..." stands for others, which may be left out."""
    signature = inspect.signature(found(name)).parameters
    given = [word.strip() for word in arguments.split(",") if word.strip()]
    more = "..." in given
    given = [word for word in given if word != "..."]
    variable = inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL
    fixed = [p.name for p in signature.values() if p.kind not in variable and p.name != "self"]
    assert given == [word for word in fixed if word in given]
    required = [p.name for p in signature.values() if p.default is p.empty and p.name in fixed]
    assert set(required if more else fixed) <= set(given)


@pytest.mark.parametrize("block", BLOCKS)
def test_each_block_is_python_and_its_imports_exist(block):
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                found(f"{node.module}.{alias.name}")
        elif isinstance(node, ast.Import):
            for alias in node.names:
                importlib.import_module(alias.name)
