"""What a perfect measurement would find at a vector, from the particles around it.

Two truths, which agree for linear flows. *Window* truth is what a perfect correlation of one interrogation window would
see: the value at the vector of a linear fit through the displacements of the window's particles. *Point* truth is the
displacement at the vector itself, of a quadratic fit through a window 1.3 times as large. Against the first a curved
flow shows the errors of the measurement, against the second those of the window's size as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
FEWEST_FOR_WINDOW = 6  # particles, for 4 coefficients
FEWEST_FOR_POINT = 16  # particles, for 10 coefficients
POINT_REACH = 1.3  # in half windows


@dataclass(frozen=True)
class TrueDisplacements:
    """At each of n vectors, displacements in mm per frame along x, y, z; NaN where particles are too few.

    ``window`` and ``point`` (n, 3); ``particles`` (n,), how many lie in the window.
    """

    window: Array
    point: Array
    particles: NDArray[np.int64]


def true_displacements(at_mm: Array, a_mm: Array, b_mm: Array, half_window_mm: Array) -> TrueDisplacements:
    """True displacements at vectors ``at_mm`` (n, 3), from particles at ``a_mm`` and ``b_mm`` (m, 3) in the two frames.

    Particles count where they are at mid-time, which is where a symmetric correlation has its vectors.
    ``half_window_mm``: half the window along x, y and z.
    """
    middle, displacement = 0.5 * (a_mm + b_mm), b_mm - a_mm
    tree = cKDTree(middle / half_window_mm)
    window = np.full(at_mm.shape, np.nan)
    point = np.full(at_mm.shape, np.nan)
    particles = np.zeros(len(at_mm), np.int64)
    for n, vector in enumerate(at_mm):
        near = tree.query_ball_point(vector / half_window_mm, 1.0, p=np.inf)
        particles[n] = len(near)
        if len(near) >= FEWEST_FOR_WINDOW:
            window[n] = _at_vector(_linear(middle[near] - vector), displacement[near])
        wide = tree.query_ball_point(vector / half_window_mm, POINT_REACH, p=np.inf)
        if len(wide) >= FEWEST_FOR_POINT:
            point[n] = _at_vector(_quadratic((middle[wide] - vector) / half_window_mm), displacement[wide])
    return TrueDisplacements(window, point, particles)


def _at_vector(terms: Array, displacement: Array) -> Array:
    """The fit's value where all but the constant term vanish."""
    return np.linalg.lstsq(terms, displacement, rcond=None)[0][0]


def _linear(offset: Array) -> Array:
    return np.column_stack([np.ones(len(offset)), offset])


def _quadratic(offset: Array) -> Array:
    x, y, z = offset.T
    return np.column_stack([np.ones(len(offset)), offset, offset**2, x * y, x * z, y * z])
