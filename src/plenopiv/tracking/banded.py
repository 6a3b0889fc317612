"""Cholesky's factor of a banded matrix, and solutions by it, without Python's lock.

SciPy's ``cholesky_banded`` and ``cho_solve_banded`` hold the lock while LAPACK works, so that parts of a field on
several threads wait for one another. The same routines are called here as SciPy hands them to Cython, by their address:
while ctypes calls, other threads go on.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

LOWER = b"L"
INT, DOUBLES = ctypes.POINTER(ctypes.c_int), ctypes.POINTER(ctypes.c_double)

Array = NDArray[np.float64]


def factor(band: Array, in_place: bool = False) -> Array:
    """Cholesky's factor (reach + 1, n), in Fortran's order, of the matrix whose lower diagonals are the rows of
    ``band`` (reach + 1, n), the main one first. ``in_place``: where ``band`` lies, which is in Fortran's order.

    Raises:
        LinAlgError: the matrix is not positive definite.
    """
    out = band if in_place else np.array(band, np.float64, order="F")
    (rows, n), info = out.shape, ctypes.c_int(0)
    _routine("dpbtrf", ctypes.c_char_p, INT, INT, DOUBLES, INT, INT)(
        LOWER, _number(n), _number(rows - 1), out.ctypes.data_as(DOUBLES), _number(rows), ctypes.byref(info)
    )
    if info.value != 0:
        raise LinAlgError(f"the leading minor of order {info.value} is not positive definite")
    return out


def solution(factor_of: Array, right: Array) -> Array:
    """The solutions (n, k) of the matrix with this ``factor`` for right sides (n, k)."""
    out = np.array(right, np.float64, order="F")
    (rows, n), info = factor_of.shape, ctypes.c_int(0)
    if not factor_of.flags.f_contiguous or out.ndim != 2 or len(out) != n:
        raise ValueError(f"right sides {right.shape} of a factor {factor_of.shape}, which is in Fortran's order")
    _routine("dpbtrs", ctypes.c_char_p, INT, INT, INT, DOUBLES, INT, DOUBLES, INT, INT)(
        LOWER, _number(n), _number(rows - 1), _number(out.shape[1]),
        factor_of.ctypes.data_as(DOUBLES), _number(rows), out.ctypes.data_as(DOUBLES), _number(n), ctypes.byref(info),
    )  # fmt: skip
    return out


@cache
def _routine(name: str, *kinds: Any) -> Any:
    return ctypes.CFUNCTYPE(None, *kinds)(get_cython_function_address("scipy.linalg.cython_lapack", name))


def _number(value: int) -> Any:
    return ctypes.byref(ctypes.c_int(value))
