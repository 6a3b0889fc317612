"""How kernels are compiled and cached: one set of flags, and a cache that notices each edit that counts, and no other.

Compiled code is kept by content (``store``): a kernel's file is named by a hash of its code, of all functions that it
calls and all constants that it takes, wherever they are defined (``fingerprint``). Numba's own cache looks at one file
alone (numba issue 1833). What is Numba's private part is in ``numba_internals``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from plenopiv.kernels.numba_internals import borrowed, compile_seconds, compiled, intrinsic

__all__ = [
    "borrowed",
    "compile_seconds",
    "inlined",
    "intrinsic",
    "kernel",
    "part",
    "part_with_way_in",
    "plain_kernel",
    "plain_part",
]

FAST = {"reassoc", "nsz", "arcp", "contract", "afn"}  # without nnan and ninf: kernels may test for them
PLAIN: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True}
FLAGS = PLAIN | {"fastmath": FAST, "error_model": "numpy"}  # an error model without exceptions lets loops vectorise
NO_WAY_IN: dict[str, Any] = {"no_cpython_wrapper": True, "forceinline": True}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile what is called from Python, fast-math."""
    return compiled(function, FLAGS)


def part(function: Callable[..., Any]) -> Any:
    """Compile what kernels alone call, fast-math, into each of them: results then have the same bits whether a kernel
    was compiled in this process or loaded. Called from Python it is the plain Python that it is written in."""
    return compiled(function, FLAGS | NO_WAY_IN)


def part_with_way_in(function: Callable[..., Any]) -> Any:
    """``part`` that is called from Python too, compiled in each process that does."""
    return compiled(function, FLAGS | {"forceinline": True})


def inlined(function: Callable[..., Any]) -> Any:
    """Compile into each caller, by Numba itself."""
    return compiled(function, FLAGS | {"inline": "always"})


def plain_kernel(function: Callable[..., Any]) -> Any:
    """``kernel`` in plain floating-point arithmetic."""
    return compiled(function, PLAIN)


def plain_part(function: Callable[..., Any]) -> Any:
    """``part`` in plain floating-point arithmetic."""
    return compiled(function, PLAIN | NO_WAY_IN)
