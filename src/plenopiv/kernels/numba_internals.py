"""All that PlenoPIV uses of Numba's private parts; pyproject.toml bounds Numba's version for its sake.

- ``CPUDispatcher``: what ``numba.njit`` makes of a function. ``Kernel`` replaces the cache behind it (``store``) and
  lets one process at a time compile a function; ``Part`` calls functions that have no way in as plain Python.
- ``CompileResult._reduce`` and ``_rebuild``: compiled code as something that pickles, and back.
- ``numba.core.event``: when Numba compiles.
- ``cgutils``: loops and slots of the stack in LLVM's terms.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import time
from collections.abc import Callable
from typing import Any

from numba import config, types
from numba import extending as numba_extending
from numba.core import cgutils, event
from numba.core.compiler import CompileResult
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps

from plenopiv.kernels.sources import Unknown, text_of
from plenopiv.kernels.store import Store, folder

__all__ = ["Inlined", "Kernel", "Part", "borrowed", "cgutils", "compile_seconds", "compiled", "event", "intrinsic"]


def _optimise_as_set() -> None:
    """LLVM's level 2 takes a tenth less to compile than Numba's usual 3, and kernels are as fast. Numba reads its
    settings anew where an environment variable has changed."""
    config.reload_config()
    if "NUMBA_OPT" not in os.environ:
        config.OPT = type(config.OPT)(2)


class Kernel(CPUDispatcher):
    """A compiled function whose code is kept by content."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._cache = Cache(Store(self.py_func, self.targetoptions))

    def compile(self, sig: Any) -> Any:
        """The machine code for one signature: what another process compiles at the moment is waited for."""
        _optimise_as_set()
        try:
            return super().compile(sig)
        finally:
            self._cache.store.release(sig)


class Inlined(CPUDispatcher):
    """A function whose code is that of its callers, into each of which LLVM inlines it. It is not kept: what is loaded
    cannot be inlined, and a call of it rounds otherwise."""

    def compile(self, sig: Any) -> Any:
        """What callers inline, for one signature."""
        _optimise_as_set()
        return super().compile(sig)


class Part(Inlined):
    """One without a way in from Python, which would fall into the void."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """The plain Python that it is written in."""
        return self.py_func(*arguments, **named)


class Cache:
    """What Numba asks of a dispatcher's cache."""

    def __init__(self, store: Store) -> None:
        self.store = store

    @property
    def cache_path(self) -> str:
        """Where compiled code is kept."""
        return str(folder())

    def load_overload(self, sig: Any, target: Any) -> CompileResult | None:
        """The compiled code of a signature; None: the caller compiles it and saves it or calls ``release``."""
        target.refresh()
        found = self.store.load(sig, target.codegen().magic_tuple())
        return None if found is None else CompileResult._rebuild(target, *pickle.loads(found))

    def save_overload(self, sig: Any, result: CompileResult) -> None:
        """Keep it, unless it holds addresses of this process."""
        if not result.lifted and not result.library.has_dynamic_globals:
            self.store.save(sig, dumps(result._reduce()))

    def flush(self) -> None:
        """Forget what this process took from the cache or put there."""
        self.store.flush()


def compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """As ``numba.njit(cache=True, **options)``, which takes neither a dispatcher nor a cache of one's own."""
    if config.DISABLE_JIT:
        return function
    kind = Part if options.get("no_cpython_wrapper") else Inlined if options.get("forceinline") else Kernel
    return kind(function, locals={}, targetoptions={"nopython": True, "boundscheck": None, **options})


def intrinsic(function: Callable[..., Any]) -> Any:
    """``numba.extending.intrinsic``, of whose source the kernels that use it depend."""
    with contextlib.suppress(Unknown):
        text_of(function.__module__)  # now: kernels are compiled later, perhaps after an edit
    return numba_extending.intrinsic(function)


class _RareCollections(event.Listener):
    """Numba makes a million objects that live on; to look among them for dead cycles as often as Python does took an
    eighth of all compilation. Numba's lock lets one thread compile at a time."""

    depth = 0
    seconds = 0.0  # of all compilation in this process

    def on_start(self, _: event.Event) -> None:
        if self.depth == 0:
            self.usual = gc.get_threshold()
            gc.set_threshold(max(self.usual[0], 50_000) if self.usual[0] else 0, *self.usual[1:])
            self.begun = time.perf_counter()
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            gc.set_threshold(*self.usual)
            self.seconds += time.perf_counter() - self.begun


_compiling = _RareCollections()
event.register("numba:compile", _compiling)


def compile_seconds() -> float:
    """What this process has spent on compiling kernels so far."""
    return _compiling.seconds


def _unowned(context: Any, builder: Any, kind: Any, value: Any) -> Any:
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
def borrowed(typing: Any, arrays: Any) -> Any:
    """The same array, or tuple of arrays and numbers, without an owner: its slices are not counted, as owners' are, at
    40 cycles each and more where threads share them. For a kernel's arguments alone, which outlive it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _unowned(context, builder, arrays, arguments[0])

    return arrays(arrays), generate
