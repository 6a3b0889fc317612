"""How kernels are compiled: one set of flags, and a cache that notices every edit.

Numba's cache looks at the time stamp of the file that holds a function, not of the files whose functions it inlines
(numba issue 1833). The cache folder is therefore named by a hash of all of PlenoPIV's sources that define kernels. A
``NUMBA_CACHE_DIR`` in the environment has precedence.
"""

from __future__ import annotations

import gc
import hashlib
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numba
from numba import config, types
from numba.core import cgutils, event
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

FAST = {"reassoc", "nsz", "arcp", "contract", "afn"}  # without nnan and ninf: kernels may test for them
PLAIN: dict[str, Any] = {"cache": True, "nogil": True, "no_cfunc_wrapper": True}
FLAGS = PLAIN | {"fastmath": FAST, "error_model": "numpy"}  # an error model without exceptions lets loops vectorise


def _sources_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        text = path.read_bytes()
        if b"numba" in text or b"plenopiv.kernels" in text or "projection" in path.parts:
            digest.update(text)
    return digest.hexdigest()[:16]


if not os.environ.get("NUMBA_CACHE_DIR"):
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    config.CACHE_DIR = str(base / "plenopiv" / _sources_hash())


class _RareCollections(event.Listener):
    """Numba makes a million objects that live on; to look among them for dead cycles as often as Python does took an
    eighth of all compilation. Numba's lock lets one thread compile at a time."""

    depth = 0

    def on_start(self, _: event.Event) -> None:
        if self.depth == 0:
            self.usual = gc.get_threshold()
            gc.set_threshold(max(self.usual[0], 50_000) if self.usual[0] else 0, *self.usual[1:])
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            gc.set_threshold(*self.usual)


event.register("numba:compile", _RareCollections())


class _Part(CPUDispatcher):
    """What kernels alone call: without a way in from Python, whose making is an eighth of all compilation."""

    def __call__(self, *arguments: Any) -> Any:
        return self.py_func(*arguments)


def _part(flags: dict[str, Any], function: Callable[..., Any]) -> Any:
    compiled = numba.njit(function, no_cpython_wrapper=True, **flags)
    compiled.__class__ = _Part
    return compiled


kernel = partial(numba.njit, **FLAGS)
plain_kernel = partial(numba.njit, **PLAIN)
inlined = partial(numba.njit, inline="always", **FLAGS)
part: Any = partial(_part, FLAGS)
plain_part: Any = partial(_part, PLAIN)


def _unowned(context, builder, kind, value):
    if isinstance(kind, types.BaseTuple):
        members = [_unowned(context, builder, k, builder.extract_value(value, n)) for n, k in enumerate(kind.types)]
        return context.make_tuple(builder, kind, members)
    if not isinstance(kind, types.Array):
        return value
    same = context.make_array(kind)(context, builder, value)
    same.meminfo = cgutils.get_null_value(same.meminfo.type)
    same.parent = cgutils.get_null_value(same.parent.type)
    return same._getvalue()


@intrinsic
def borrowed(typing, arrays):
    """The same array, or tuple of arrays and numbers, without an owner: its slices are not counted, as owners' are, at
    40 cycles each and more where threads share them. For a kernel's arguments alone, which outlive it."""

    def generate(context, builder, signature, arguments):
        return _unowned(context, builder, arrays, arguments[0])

    return arrays(arrays), generate
