"""What a kernel's machine code depends on, as a hash.

That is the kernel's byte code and constants without its docstring, the same of all functions that it calls, and the
values of all globals, defaults and closures that they take. Comments, line numbers, paths and other functions of the
same file do not count. What is hashed is in memory, at the moment at which a kernel is compiled.

An intrinsic writes machine code in Python's terms: the text of its whole module counts, and of the modules that this
imports (``sources``). The same holds where a kernel takes a value of a kind that is not told apart here. Where there is
no text, compiled code is not kept (``Unknown``).
"""

from __future__ import annotations

import hashlib
import opcode
import sys
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import types
from numba.extending import is_jitted

from plenopiv.kernels.sources import LIBRARIES, Unknown, hash_of_sources, in_libraries, text_of

PLAIN = {type(None), bool, int, float, complex, str, bytes, type(...)}
SETTINGS = "OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "ENABLE_AVX"
TYPES = types.Number, types.Boolean, types.NoneType, types.UnicodeType, types.SliceType
LOAD_GLOBAL, EXTENDED_ARG = opcode.opmap["LOAD_GLOBAL"], opcode.opmap["EXTENDED_ARG"]


def fingerprint(function: FunctionType, options: dict[str, Any], signature: Any, machine: Any) -> str:
    """Hash of a function compiled with ``options`` for a signature (types of arguments; or with the type returned) on a
    ``machine`` (a plain value that describes it).

    Raises:
        Unknown: the content of something that it depends on cannot be told.
    """
    walk = _Walk()
    walk.put("made by", _versions(), repr(machine), repr([getattr(numba.config, name, None) for name in SETTINGS]))
    plain = isinstance(signature, tuple)
    for kind in signature if plain else signature.args:
        walk.type(kind)
    walk.put("returns", "" if plain else str(signature.return_type))
    walk.options(options)
    walk.function(function)
    return walk.end()


@cache
def _versions() -> str:
    """Of all that compiles, and of what is hashed."""
    packages = sys.version, numba.__version__, llvmlite.__version__, np.__version__
    return repr(packages) + "".join(hashlib.sha256(text_of(m)).hexdigest() for m in (__name__, text_of.__module__))


@cache
def _taken_apart(code: CodeType, docstring: str | None) -> tuple[str, tuple[str, ...], frozenset[str]]:
    """What of a code object says what it does; the globals that it loads; all names in it, attributes' too."""
    words, constants, loaded, extended = code.co_code, list(code.co_consts), [], 0
    names, text_at_work = set(code.co_names), False
    for n in range(0, len(words), 2):
        operation, argument = words[n], words[n + 1] | extended
        extended = argument << 8 if operation == EXTENDED_ARG else 0
        if operation == LOAD_GLOBAL:
            loaded.append(code.co_names[argument >> 1])
        text_at_work |= operation in opcode.hasconst and argument == 0
    if docstring is not None and constants and constants[0] == docstring and not text_at_work:
        constants[0] = None
    for n, constant in enumerate(constants):
        if isinstance(constant, CodeType):
            constants[n], inner_loaded, inner_names = _taken_apart(constant, None)
            loaded += inner_loaded
            names |= inner_names
        elif isinstance(constant, frozenset):
            constants[n] = sorted(map(repr, constant))
    facts = (
        words, constants, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount,
        code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags, code.co_exceptiontable,
    )  # fmt: skip
    return repr(facts), tuple(dict.fromkeys(loaded)), frozenset(names)


class _Walk:
    """Through all that a function depends on, each function once: each is told by its number after that."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self.functions: dict[FunctionType, int] = {}

    def put(self, *words: str | bytes) -> None:
        """Hash words, with their ends."""
        for word in words:
            held = word if isinstance(word, bytes) else word.encode()
            self.hash.update(b"%d:" % len(held) + held)

    def end(self) -> str:
        """Go through the functions met; more of them are met meanwhile."""
        done = 0
        while done < len(self.functions):
            self.body(list(self.functions)[done])
            done += 1
        return self.hash.hexdigest()[:32]

    def function(self, function: FunctionType) -> None:
        """Note a function; its body's turn is later, so that functions may call each other in circles."""
        self.put("function", str(self.functions.setdefault(function, len(self.functions))))

    def body(self, function: FunctionType) -> None:
        """A function's code, defaults, closure and globals."""
        facts, loaded, names = _taken_apart(function.__code__, function.__doc__)
        self.put("body", function.__module__, function.__qualname__, facts)
        for default in (function.__defaults__ or (), *(function.__kwdefaults__ or {}).items()):
            self.value(default, function.__module__, names)
        for cell in function.__closure__ or ():
            try:
                held = cell.cell_contents
            except ValueError:
                raise Unknown(f"a variable of {function.__qualname__} that is not set yet") from None
            self.value(held, function.__module__, names)
        built_in = vars(sys.modules["builtins"])
        for name in loaded:
            self.put("global", name)
            if name in function.__globals__:
                self.value(function.__globals__[name], function.__module__, names)
            else:
                self.put("built in" if name in built_in else "missing")

    def options(self, options: dict[str, Any]) -> None:
        """How a function is compiled."""
        for name, value in sorted(options.items()):
            self.put("option", name, repr(sorted(value) if isinstance(value, set | frozenset) else value))

    def value(self, value: Any, module: str, names: frozenset[str]) -> None:
        """What a function of ``module`` takes, ``names`` being in its code."""
        kind = type(value)
        if kind in PLAIN:
            self.put(kind.__name__, repr(value))
        elif isinstance(value, np.generic | np.ndarray) and not value.dtype.hasobject:
            self.put("array", str(kind), repr(value.dtype), repr(value.shape), repr(value.strides), value.tobytes())
        elif kind in (tuple, list) or (isinstance(value, tuple) and hasattr(kind, "_fields")):
            self.put("sequence", kind.__module__, kind.__qualname__, str(len(value)))
            self.put(*getattr(kind, "_fields", ()))
            for member in value:
                self.value(member, module, names)
        elif isinstance(value, ModuleType):
            self.module(value, names)
        elif is_jitted(value):
            self.options(value.targetoptions)
            self.function(value.py_func)
        elif isinstance(value, types.Type):
            self.type(value)
        elif isinstance(value, np.ufunc):
            self.put("ufunc", value.__name__)
        elif in_libraries(value):
            self.put("library", value.__module__, value.__qualname__)
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            self.named_tuple(value)
        else:
            if in_libraries(kind) and isinstance(getattr(value, "__wrapped__", None), FunctionType):
                value, module = value.__wrapped__, value.__module__  # an intrinsic
            if isinstance(value, FunctionType):
                module = value.__module__
                self.function(value)
            self.put("text", hash_of_sources(module))

    def named_tuple(self, kind: Any) -> None:
        """A class of tuples whose members have names."""
        self.put("class", kind.__module__, kind.__qualname__, *kind._fields)
        for default in kind._field_defaults.items():
            self.value(default, kind.__module__, frozenset())

    def module(self, module: ModuleType, names: frozenset[str]) -> None:
        """Of a library, its name; of others, what a function that holds ``names`` may take from it."""
        self.put("module", module.__name__)
        if module.__name__.partition(".")[0] in LIBRARIES:
            return
        if "__getattr__" in vars(module):
            self.put("text", hash_of_sources(module.__name__))
        for name in sorted(names & vars(module).keys()):
            self.put("attribute", name)
            self.value(vars(module)[name], module.__name__, names - {name})

    def type(self, kind: Any) -> None:
        """The type of an argument."""
        if isinstance(kind, types.Dispatcher):
            self.value(kind.dispatcher, "", frozenset())
        elif isinstance(kind, types.BaseTuple):
            self.put("tuple", str(kind.count))
            if hasattr(kind, "instance_class"):
                self.named_tuple(kind.instance_class)
            for member in kind.types:
                self.type(member)
        elif isinstance(kind, types.Literal | types.Omitted):
            value = kind.literal_value if isinstance(kind, types.Literal) else kind.value
            self.put(type(kind).__name__)
            self.value(value, "", frozenset())
        elif isinstance(kind, TYPES) or (type(kind) is types.Array and isinstance(kind.dtype, TYPES)):
            self.put("type", type(kind).__name__, str(kind))
        else:
            raise Unknown(f"argument of type {kind}")
