"""The text of modules, where a kernel depends on a module as a whole."""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from typing import Any

# told by their names: their versions are hashed, or are Python's
LIBRARIES = {"builtins", "math", "cmath", "operator", "typing", "collections", "numpy", "numba", "llvmlite"}
WITHOUT_EFFECT = {"", ".fingerprint", ".sources", ".store"}  # of this package, on machine code: flags are values


class Unknown(Exception):
    """The content of something that a kernel depends on cannot be told."""


def in_libraries(thing: Any) -> bool:
    """Whether a function or class is known by its name."""
    module = getattr(thing, "__module__", None)
    return isinstance(module, str) and module.partition(".")[0] in LIBRARIES and hasattr(thing, "__qualname__")


@cache
def text_of(module: str) -> bytes:
    """A module's text, as it is when it is first asked for: an intrinsic's while it is imported, before an edit.

    Raises:
        Unknown: it has none.
    """
    path = getattr(sys.modules.get(module), "__file__", None) or ""
    try:
        if path.endswith(".py"):
            with open(path, "rb") as file:
                return file.read()
    except OSError:
        pass
    raise Unknown(f"module {module} without a source file")


@cache
def hash_of_sources(module: str) -> str:
    """Of a module's text and that of all it imports, directly or not, but for libraries and what comes with Python.

    Raises:
        Unknown: one of them has no text.
    """
    found: dict[str, bytes] = {}
    pending = [module]
    while pending:
        name = pending.pop()
        if name in found:
            continue
        top = name.partition(".")[0]
        edition = getattr(sys.modules.get(top), "__version__", None)
        if edition is not None and top not in (module.partition(".")[0], __name__.partition(".")[0]):
            found[name] = str(edition).encode()  # of another project
            continue
        found[name] = text_of(name)
        pending += _imported(name, found[name])
    digest = hashlib.sha256()
    for name in sorted(found):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(found[name]).digest())
    return digest.hexdigest()


def _imported(module: str, text: bytes) -> Iterator[str]:
    """Modules, loaded by now, that the text imports."""
    own, package = sys.modules[module], __name__.rpartition(".")[0]
    for node in ast.walk(ast.parse(text)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), own.__package__ or "")
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        for name in names:
            top = name.partition(".")[0]
            if top in LIBRARIES or top in sys.stdlib_module_names or name not in sys.modules:
                continue
            if name.startswith(package) and name[len(package) :] in WITHOUT_EFFECT:
                continue
            yield name
