"""What is known of each particle by itself, all others taken as known: from its own pixels alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.threads import in_threads
from plenopiv.tracking.equations import own_equations
from plenopiv.tracking.light import Lights
from plenopiv.tracking.normal_kernels import mean_misfit
from plenopiv.tracking.steps import LEAST_KNOWN

Array = NDArray[np.float64]
Single = NDArray[np.float32]


def alone(lights: Lights, light: Array, weight: Single, chi2: Array, information: Array) -> Array:
    """Of each particle (n, 2): the misfit, the mean of chi^2 of its pixels weighed with its light in them, and by how
    much it lowers chi^2, all others known. ``weight`` and ``chi2``: of each pixel; ``information`` (n, 3): of the
    priors."""
    off = misfits(lights, chi2)
    own, _ = own_equations(lights, light, weight, np.zeros_like(weight))
    covariance = np.asarray(np.linalg.inv(with_priors(own, information)), np.float64)
    return np.stack([off, lowers(covariance, off)], -1)


def misfits(lights: Lights, chi2: Array) -> Array:
    """Of particles whose light goes where ``lights`` say, the mean (n,) of their pixels' ``chi2``, NaN in pixels that
    cannot be used."""
    off = np.empty(len(lights.start) - 1)
    in_threads(mean_misfit, len(off), lights.start, lights.pixel, lights.share, chi2, off)
    return off


def lowers(covariance: Array, misfits: Array) -> Array:
    """By how much the light of each particle (n,) lowers chi^2, of its ``covariance`` (n, 4, 4)."""
    return np.asarray(1.0 / np.maximum(covariance[:, 3, 3], 1e-30) / np.maximum(misfits, 1.0))


def with_priors(own: Array, information: Array) -> Array:
    """What is known of particles by themselves: their ``own`` blocks (n, 4, 4) with the priors' ``information`` (n, 3)
    on their places, and a little on all, as pixels may say nothing."""
    known = own + LEAST_KNOWN * np.eye(4)
    known[:, range(3), range(3)] += information
    return known
