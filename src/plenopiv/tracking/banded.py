"""Cholesky's factor of a banded matrix, and solutions by it, without Python's lock but for small blocks.

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
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import LinAlgError
from scipy.linalg.blas import dtrsm

LOWER = b"L"
SEVERAL = 8  # right sides, from which on blocks of WIDTH unknowns take less time than LAPACK, which solves one by one
WIDTH = 64
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
    if out.shape[1] >= SEVERAL and rows > WIDTH:
        for backward in (False, True):
            _solve_blocks(factor_of, out, backward)
        return out
    _routine("dpbtrs", ctypes.c_char_p, INT, INT, INT, DOUBLES, INT, DOUBLES, INT, INT)(
        LOWER, _number(n), _number(rows - 1), _number(out.shape[1]),
        factor_of.ctypes.data_as(DOUBLES), _number(rows), out.ctypes.data_as(DOUBLES), _number(n), ctypes.byref(info),
    )  # fmt: skip
    return out


def _solve_blocks(factor_of: Array, right: Array, backward: bool) -> None:
    """Solve L x = ``right`` (n, k), or L^T x = ``right``, in place, WIDTH unknowns at a time."""
    rows, n = factor_of.shape
    starts = range(0, n, WIDTH)
    for low in reversed(starts) if backward else starts:
        width = min(WIDTH, n - low)
        own = _part(factor_of, low, low, width, width)
        whole = slice(low + width, min(low + rows, n))  # rows that the band has in all columns ...
        partly = slice(whole.stop, min(low + rows - 1 + width, n))  # ... and in the later ones alone
        others = []
        if whole.stop > whole.start:
            columns = slice(low, low + width)
            others.append((whole, columns, _part(factor_of, whole.start, low, whole.stop - whole.start, width)))
        if partly.stop > partly.start:
            columns = slice(low + 1, low + width)
            below = _part(factor_of, partly.start, low + 1, partly.stop - partly.start, width - 1)
            others.append((partly, columns, np.triu(below)))
        if backward:
            for below_rows, columns, part in others:
                right[columns] -= part.T @ right[below_rows]
        right[low : low + width] = dtrsm(1.0, own, right[low : low + width], lower=1, trans_a=int(backward))
        if not backward:
            for below_rows, columns, part in others:
                right[below_rows] -= part @ right[columns]


def _part(factor_of: Array, row: int, column: int, height: int, width: int) -> Array:
    """A view of the rows and columns of the matrix whose band is ``factor_of``, wrong beyond the band."""
    step, rows = factor_of.itemsize, len(factor_of)
    whole = factor_of.T.reshape(-1)[column * rows + row - column :]
    return as_strided(whole, (height, width), (step, step * (rows - 1)))


@cache
def _routine(name: str, *kinds: Any) -> Any:
    return ctypes.CFUNCTYPE(None, *kinds)(get_cython_function_address("scipy.linalg.cython_lapack", name))


def _number(value: int) -> Any:
    return ctypes.byref(ctypes.c_int(value))
