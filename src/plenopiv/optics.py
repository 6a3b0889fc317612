"""Linear Gaussian optics of a plenoptic camera: the ray-transfer matrices of the paper and what follows from them.

Source: Shi, Ding & New (2016), Eqs. 1-5 (after Georgiev et al. 2003). A ray is the column ``(x, y, theta, phi)``:
position in mm and direction as slopes (rad in the paraxial limit). Distances are in mm and positive.

Multiplying the matrices out gives the two scalar relations that everything else here uses:

    s = A(z) u + B(z) x      with  A = 1 + S_i/d - S_i/f_m,   B = -S_i/d,   d = S_o - z
    sensor position = S (1 + e) + e ((s - S) - u)             with  e = f_l / S_i

``u`` is where the ray crosses the main lens, ``s`` where it meets the microlens plane, ``S`` the centre of the
microlens that holds ``s``. The same holds for ``(v, t, y)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]


def propagation(distance_mm: float) -> Matrix:
    """Free space over a distance in mm (Eqs. 1, 3 and 5)."""
    m = np.eye(4)
    m[0, 2] = m[1, 3] = distance_mm
    return m


def thin_lens(focal_length_mm: float) -> Matrix:
    """Refraction by a thin lens on the axis (Eq. 2)."""
    m = np.eye(4)
    m[2, 0] = m[3, 1] = -1.0 / focal_length_mm
    return m


def microlens_offset(centre_mm: ArrayLike, focal_length_mm: float) -> Matrix:
    """What a microlens centred off the axis at ``(S_x, S_y)`` mm adds to a ray's slopes (Eq. 4, second term)."""
    sx, sy = np.asarray(centre_mm, dtype=float)
    return np.array([0.0, 0.0, sx / focal_length_mm, sy / focal_length_mm])


def magnification(image_distance_mm: float, object_distance_mm: float) -> float:
    """M = -S_i / S_o: negative, the image is inverted."""
    return -image_distance_mm / object_distance_mm


def conjugate_distances(focal_length_mm: float, magnification: float) -> tuple[float, float]:
    """Object and image distance (S_o, S_i) in mm of a thin lens at a magnification M < 0.

    From 1/f = 1/S_o + 1/S_i and M = -S_i/S_o: S_o = f (1 - 1/M), S_i = f (1 - M).
    """
    return focal_length_mm * (1.0 - 1.0 / magnification), focal_length_mm * (1.0 - magnification)


def spread(z_mm: ArrayLike, object_distance_mm: float, image_distance_mm: float, focal_length_mm: float) -> NDArray:
    """A(z) = ds/du: how far a point's rays spread on the microlens plane per mm on the main lens. Zero in focus."""
    d = object_distance_mm - np.asarray(z_mm, dtype=float)
    return 1.0 + image_distance_mm / d - image_distance_mm / focal_length_mm


def scale(z_mm: ArrayLike, object_distance_mm: float, image_distance_mm: float) -> NDArray:
    """B(z) = ds/dx: the magnification of the plane at z (negative)."""
    return -image_distance_mm / (object_distance_mm - np.asarray(z_mm, dtype=float))
