"""How kernels are compiled and cached: one set of flags, and a cache that notices each edit that counts, and no other.

Compiled code is kept by content (``store``): a kernel's file is named by a hash of its code, of all functions that it
calls and all constants that it takes, wherever they are defined (``fingerprint``). Numba's own cache looks at one file
alone (numba issue 1833). What is Numba's private part is in ``numba_internals``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from plenopiv.kernels.numba_internals import borrowed, compiled, intrinsic

__all__ = ["borrowed", "inlined", "intrinsic", "kernel", "part", "plain_kernel", "plain_part"]

FAST = {"reassoc", "nsz", "arcp", "contract", "afn"}  # without nnan and ninf: kernels may test for them
PLAIN: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True}
FLAGS = PLAIN | {"fastmath": FAST, "error_model": "numpy"}  # an error model without exceptions lets loops vectorise
NO_WAY_IN: dict[str, Any] = {"no_cpython_wrapper": True}  # making it is an eighth of all compilation


def kernel(function: Callable[..., Any]) -> Any:
    """Compile what is called from Python, fast-math."""
    return compiled(function, FLAGS)


def part(function: Callable[..., Any]) -> Any:
    """Compile what kernels alone call, fast-math. Called from Python it is the plain Python that it is written in."""
    return compiled(function, FLAGS | NO_WAY_IN)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile into each caller, by Numba itself."""
    return compiled(function, FLAGS | {"inline": "always"})


def plain_kernel(function: Callable[..., Any]) -> Any:
    """``kernel`` in plain floating-point arithmetic."""
    return compiled(function, PLAIN)


def plain_part(function: Callable[..., Any]) -> Any:
    """``part`` in plain floating-point arithmetic."""
    return compiled(function, PLAIN | NO_WAY_IN)
