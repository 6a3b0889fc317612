"""All particles of one frame whose places are predicted.

Where the prediction is good, a particle is a few standard deviations from its place, and one joint fit is enough: no
volume, no first guess, no passes. Before it, each predicted particle is asked by itself whether its light is there, so
that those that have left do not push the others; after the first step, what is left in the pixels is searched once for
new ones. Light follows its derivatives where a step is small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.evidence import present
from plenopiv.tracking.frame import FIRST_LIGHT, NONE, FrameParticles, Progress, judged
from plenopiv.tracking.light import LightOfPoints
from plenopiv.tracking.pixels import Pixels, with_noise
from plenopiv.tracking.refine import Effort, Prior, refine, residual_of
from plenopiv.volume import Limits

PASSES = 3  # of steps and searches, at most
MANY = 0.2  # share of particles found in a pass from which on another follows
EFFORT = Effort(0.1, 0.04)  # of the last fit too: nothing follows it
STEPS = 2  # Gauss-Newton iterations of the last fit
NOISE_OF = 40_000  # pixels that noise is measured on
NEIGHBOURS = 12  # whose parameters are free in the error bars

Array = NDArray[np.float64]


def particles_of_prediction(
    of_points: LightOfPoints,
    pixels: Pixels,
    position_mm: Array,
    std_mm: Array,
    light: Array,
    limits_mm: Limits,
    progress: Progress | None = None,
) -> tuple[FrameParticles, NDArray[np.int64]]:
    """The particles of one frame from predicted positions (n, 3) mm, known to ``std_mm`` (n, 3), and light (n,) counts,
    one factor of which is free; and of each found particle which of the predicted ones it is, -1 for those that were
    found within ``limits_mm``.

    Raises:
        PlenoPIVError: nothing is predicted, or the pixels speak for no particle.
    """
    if len(light) == 0:
        raise PlenoPIVError(NONE)
    wide = of_points.prior_std_mm
    prior = Prior(position_mm, np.minimum(std_mm, wide))
    fit = refine(of_points, pixels, position_mm, light, prior, 0)
    pixels, light, there = present(fit, pixels, NOISE_OF)
    if not there.any():
        raise PlenoPIVError(NONE)
    origin = np.flatnonzero(there)
    lights = fit.carried(origin, np.empty((0, 3)))
    position, light, prior = position_mm[origin], light[origin], prior.of(origin)
    for done in range(PASSES):
        fit = refine(of_points, pixels, position, light, prior, 1, EFFORT, lights)
        pixels = with_noise(pixels, fit.image, NOISE_OF)
        residual, variance = residual_of(fit.image, pixels)
        excess = np.where(pixels.usable, residual / np.sqrt(variance), np.nan)
        new, _ = of_points.places(excess, limits_mm)
        if progress is not None:
            progress(done + 1, PASSES + 1)
        lights = fit.carried(np.arange(len(fit.light)), new)
        position, prior = np.concatenate([fit.position_mm, new]), prior.joined(new, wide)
        light = np.concatenate([fit.light, np.full(len(new), FIRST_LIGHT * float(np.median(fit.light)))])
        origin = np.concatenate([origin, np.full(len(new), -1)])
        if len(new) <= MANY * len(light):
            break
    fit = refine(of_points, pixels, position, light, prior, STEPS, EFFORT, lights)
    found, kept = judged(fit, pixels, NEIGHBOURS)
    return found, origin[kept]
