"""The step of many particles at once: normal equations that are solved without being made.

With J (pixels, 4n) the derivatives of pixels' counts by the unknowns, x, y, z in ``Lights.unit_mm`` and light in units
of each particle's own, and W the pixels' weights, one over their standard deviations, the equations of a step s are

    (J^T W^2 J + prior + damping) s = slope .

Conjugate gradients ask only for products with J and its transpose, which are sums over the lists of pixels; each
particle's own block is the preconditioner. A few products do, as the next iteration begins where this one ends (inexact
Newton: Nocedal & Wright, *Numerical Optimization* (2006), section 7.1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from plenopiv.threads import in_threads
from plenopiv.tracking import normal_kernels
from plenopiv.tracking.equations import entries
from plenopiv.tracking.light import Lights

TOLERANCE, PRODUCTS = 0.01, 80  # of conjugate gradients
DAMPING = 1e-3  # of each particle's own information (Levenberg-Marquardt)
LEAST_KNOWN = 1e-12  # information added to a particle's, of whose light no pixel is used
PARTS = 4  # of the particles, where threads share them: bits do not depend on the number of threads

Array = NDArray[np.float64]
Single = NDArray[np.float32]


def step_of(
    lights: Lights,
    light: Array,
    weight: Single,
    which: NDArray[np.int64],
    own: Array,
    information: Array,
    slope: Array,
    parts: int = PARTS,
) -> Array:
    """The step (k, 4) of the particles ``which`` (k,) of all (n,), which others of them do not make. ``own`` (k, 4, 4):
    each one's own block; ``information`` (k, 3): the prior's; ``slope`` (k, 4): the right side; ``weight``: of each
    pixel; ``parts``: of the particles, each summed by itself."""
    k, diagonal = len(which), np.einsum("nii->ni", own).copy()
    extra = DAMPING * diagonal + LEAST_KNOWN
    extra[:, :3] += information
    inverse = np.linalg.inv(own + extra[:, :, None] * np.eye(4))
    scale = np.concatenate([np.broadcast_to(lights.unit_mm, (k, 3)), np.ones((k, 1))], 1) * light[which, None]
    bounds = np.array([k * part // parts for part in range(parts + 1)])
    changes, changed = np.zeros((parts, len(weight)), np.float32), np.empty(len(weight), np.float32)
    square, sums = weight * weight, np.empty((k, 4), np.float32)

    def times(v: Array) -> Array:
        step = v.reshape(k, 4)
        scaled = (step * scale).astype(np.float32)
        in_threads(normal_kernels.light_changes, parts, *entries(lights), which, scaled, bounds, changes)
        in_threads(normal_kernels.gather_changes, len(weight), changes, square, changed)
        in_threads(normal_kernels.sums_of_changes, k, *entries(lights), which, changed, sums)
        return (sums * scale + extra * step).ravel()

    def precondition(v: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", inverse, v.reshape(k, 4))).ravel()

    shape = (4 * k, 4 * k)
    equations, alone = LinearOperator(shape, times, dtype=np.float64), LinearOperator(shape, precondition)
    step, _ = cg(equations, slope.ravel(), rtol=TOLERANCE, maxiter=PRODUCTS, M=alone)
    return np.asarray(step, np.float64).reshape(k, 4)
