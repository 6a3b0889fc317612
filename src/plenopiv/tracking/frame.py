"""All particles of one frame: first guess, joint fit, particles left out and found in what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.areas import in_order
from plenopiv.tracking.covariance import NEIGHBOURS as MOST_NEIGHBOURS
from plenopiv.tracking.evidence import errors_of, without_evidence
from plenopiv.tracking.light import LightOfPoints
from plenopiv.tracking.pixels import SAMPLE, Pixels
from plenopiv.tracking.refine import Fit, Prior, first_light, refine
from plenopiv.tracking.splits import crowded, near_any, splits
from plenopiv.volume import Limits

PASSES = 8  # of fitting and searching, at most
FIRST_STEPS, STEPS = 4, 3  # Gauss-Newton iterations of the first pass, and of those after it
NEIGHBOURS = 12  # whose parameters are free where particles are judged on the way
FEW = 0.01  # share of particles left out and found below which no other pass follows
LAST_STEPS = 6
STILL = 0.03  # standard deviations by which its own pixels must pull a particle for it to move, in the last fit ...
ROUGHLY = 1.0  # ... and on the way
BEGUN = 1.5  # times the median's misfit that counts against a particle on the way, where it has only begun to fit
NEAR, ROUGHLY_NEAR = 0.01, 0.04  # units within which light follows its derivatives, in the last fit and on the way
UNLIT = 1e-7  # counts of a pixel that no particle lights
FIRST_LIGHT = 0.5  # of the median particle's, of a particle that is found in what is left

NONE = "tracking: the pixels speak for no particle; check camera, calibration and noise with plenopiv check"

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FrameParticles:
    """Particles of one frame.

    ``position_mm`` (n, 3); ``light`` (n,), counts of all pixels together; ``covariance`` (n, 4, 4) of x, y, z (mm) and
    light (counts), larger where pixels scatter more than their noise; ``misfit`` (n,), chi^2 of a particle's pixels per
    pixel; ``chi2``: that of all lit pixels.

    What pixels alone say of positions, without the prior that is in ``covariance``: ``information`` (n, 3, 3) mm^-2,
    next to nothing along depth near focus, and ``pull`` (n, 3) mm^-1, by which the logarithm of their likelihood grows
    with the position; None where that is not known.
    """

    position_mm: Array
    light: Array
    covariance: Array
    misfit: Array
    chi2: float
    information: Array | None = None
    pull: Array | None = None

    def of(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> FrameParticles:
        """The particles ``which`` alone."""
        said = (None if each is None else each[which] for each in (self.information, self.pull))
        parts = self.position_mm[which], self.light[which], self.covariance[which], self.misfit[which]
        return FrameParticles(*parts, self.chi2, *said)


def particles_of_frame(
    of_points: LightOfPoints,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    limits_mm: Limits,
    progress: Progress | None = None,
) -> FrameParticles:
    """The particles of one frame from a first guess of positions (n, 3) mm and light (n,) counts; others are looked for
    within ``limits_mm``.

    Raises:
        PlenoPIVError: there is no first guess, or the pixels speak for no particle.
    """
    if len(light) == 0:
        raise PlenoPIVError(NONE)
    order = in_order(position_mm[:, :2])
    position_mm, light = position_mm[order], light[order]
    prior = Prior(position_mm, of_points.prior_std_mm)
    light = first_light(of_points, pixels, position_mm, light)
    position, lights, image = position_mm, None, None
    off = np.full(len(light), np.nan)  # misfits, of particles that have been looked at
    known = np.empty((0, 3))  # of which particles it is known whether they are two
    for done in range(PASSES):
        steps = STEPS if done else FIRST_STEPS
        fit = refine(of_points, pixels, position, light, prior, steps, ROUGHLY, ROUGHLY_NEAR, lights, image, done)
        pixels = with_noise(pixels, fit.image)
        changed = np.flatnonzero(fit.moved | np.isnan(off))
        covariance, off[changed] = errors_of(fit, pixels.usable, NEIGHBOURS, changed)
        most, out = BEGUN * float(np.median(off)), np.zeros(len(off), bool)
        out[changed] = without_evidence(fit, covariance, np.minimum(off[changed], most), which=changed)
        if out.all():
            raise PlenoPIVError(NONE)
        typical = float(np.median(fit.light[~out]))
        asked = crowded(fit, off) & fit.moved & ~(out | near_any(fit.position_mm, known, fit.unit_mm))
        pairs, half = splits(fit, off, asked)
        excess = np.where(pixels.usable, fit.residual / np.sqrt(fit.variance), np.nan)
        places, _ = of_points.places(excess, limits_mm)
        if progress is not None:
            progress(done + 1, PASSES + 1)
        changes, middle = len(places) + len(pairs) + out.sum(), fit.position_mm[pairs]
        out[pairs] = True
        new = np.concatenate([places, middle + half, middle - half])
        known = np.concatenate([known, fit.position_mm[asked] if done else middle])  # the first fit is a rough one
        of_new = np.concatenate([np.full(len(places), FIRST_LIGHT * typical), np.tile(0.5 * fit.light[pairs], 2)])
        position, light = np.concatenate([fit.position_mm[~out], new]), np.concatenate([fit.light[~out], of_new])
        off = np.concatenate([off[~out], np.full(len(new), np.nan)])
        prior, image = Prior(np.concatenate([prior.position_mm[~out], new]), prior.std_mm), fit.image
        of_points(fit.position_mm[out]).add_to(image, -fit.light[out])
        found = of_points(new)
        found.add_to(image, of_new)
        lights = fit.carried(np.flatnonzero(~out), found)
        del fit
        if changes <= FEW * len(light):
            break
    fit = refine(of_points, pixels, position, light, prior, LAST_STEPS, STILL, NEAR, lights, image)
    return judged(fit, pixels)[0]


def with_noise(pixels: Pixels, image: Array, sample: int = SAMPLE) -> Pixels:
    """The pixels with noise as particles of so many counts in the ``image`` leave it, measured on a ``sample``."""
    return pixels.with_measured_noise(~lit_by(image), image, sample)


def lit_by(image: Array) -> NDArray[np.bool_]:
    """Which pixels any particle lights: sums leave rounding where light was taken away again."""
    return image > UNLIT


def judged(fit: Fit, pixels: Pixels, neighbours: int = MOST_NEIGHBOURS) -> tuple[FrameParticles, NDArray[np.bool_]]:
    """What the last fit found, without particles that the pixels do not speak for, and which (n,) are left.
    ``neighbours``: whose parameters are free in the error bars."""
    covariance, off = errors_of(fit, pixels.usable, neighbours)
    kept = ~without_evidence(fit, covariance, off, swarms=False)
    scale = np.maximum(off[kept], 1.0)
    unit_mm = fit.unit_mm
    information, pull = _of_pixels_alone(fit.position_mm[kept], covariance[kept], fit.prior.of(kept), unit_mm)
    unit = np.concatenate([np.broadcast_to(unit_mm, (len(fit.light), 3)), fit.light[:, None]], 1)[kept]
    lit = lit_by(fit.image) & pixels.usable
    found = FrameParticles(
        fit.position_mm[kept],
        fit.light[kept],
        covariance[kept] * unit[:, :, None] * unit[:, None, :] * scale[:, None, None],
        off[kept],
        float(np.mean(fit.residual[lit] ** 2 / fit.variance[lit])),
        information / scale[:, None, None],
        pull / scale[:, None],
    )
    return found, kept


def _of_pixels_alone(position_mm: Array, covariance: Array, prior: Prior, unit_mm: Array) -> tuple[Array, Array]:
    """Information (n, 3, 3) mm^-2 and slope (n, 3) mm^-1 of what pixels say, light and neighbours free: the prior is
    taken off the fit's ``covariance`` (n, 4, 4), in the fit's units. Where a fit rests the slopes of both cancel."""
    whole, of_prior = np.linalg.inv(covariance[:, :3, :3]), prior.information(unit_mm)
    for axis in range(3):
        whole[:, axis, axis] -= of_prior[:, axis]
    values, vectors = np.linalg.eigh(whole)
    information = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    pull = of_prior / unit_mm**2 * (position_mm - prior.position_mm)
    return information / unit_mm[:, None] / unit_mm, pull
