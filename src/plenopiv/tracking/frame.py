"""All particles of one frame: first guess, joint fit, particles left out and found in what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.areas import in_order
from plenopiv.tracking.covariance import NEIGHBOURS as MOST_NEIGHBOURS
from plenopiv.tracking.evidence import doubtful, errors_of, present, without_evidence
from plenopiv.tracking.light import LightOfPoints, Lights, check_number
from plenopiv.tracking.pixels import Pixels, lit_by, with_noise
from plenopiv.tracking.refine import Effort, Fit, Prior, add_light, first_light, refine
from plenopiv.tracking.splits import crowded, near_any, splits
from plenopiv.volume import Limits, as_points, check_limits

PASSES, KNOWN_PASSES = 8, 5  # of fitting and searching, at most; and where the first frame of a pair is known
FIRST_STEPS, KNOWN_STEPS, STEPS = 4, 1, 3  # Gauss-Newton iterations of the first pass, and of those after it
NEIGHBOURS = 12  # whose parameters are free where particles are judged on the way
FEW = 0.01  # share of particles left out and found below which no other pass follows
FEWEST = 0.5  # of the particles that are expected in a second frame: fewer there, and they were expected elsewhere
LAST_STEPS = 6
FIRST, ON_THE_WAY = Effort(1.0, 0.04), Effort(1.0, 0.04, told=True)  # of the first fit, and of those after it
LAST = Effort(0.03, 0.01)
BEGUN = 1.5  # times the median's misfit that counts against a particle on the way, where it has only begun to fit
FIRST_LIGHT = 0.5  # of the median particle's, of a particle that is found in what is left

NONE = "tracking: the pixels speak for no particle; check camera, calibration and noise with plenopiv check"
ELSEWHERE = "tracking: the particles of the first frame are not where they are expected in the second"

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
    within ``limits_mm``. Guesses with a number that is not finite are left out.

    Raises:
        PlenoPIVError: there is no first guess, the pixels speak for no particle, or they are not as many as those of
            the cameras.
    """
    check_limits("tracking", limits_mm)
    position_mm, light = _begun(of_points, pixels, position_mm, light)
    prior = Prior(position_mm, of_points.prior_std_mm)
    light = first_light(of_points, pixels, position_mm, light)
    begin = _Start(position_mm, light, prior, None, np.empty((0, 3)), FIRST_STEPS, PASSES)
    return _in_passes(of_points, pixels, begin, limits_mm, progress)


def particles_of_second_frame(
    of_points: LightOfPoints,
    pixels: Pixels,
    expected_mm: Array,
    light: Array,
    limits_mm: Limits,
    progress: Progress | None = None,
) -> FrameParticles:
    """The particles of the second frame of a pair, from where those of the first are expected in it (n, 3) mm, within a
    few voxels, and their light (n,) counts there, one factor of which is free. Nothing else is taken from the first
    frame: errors of both are independent. Those with a number that is not finite are left out.

    Raises:
        PlenoPIVError: fewer than FEWEST of them are there, the pixels speak for no particle, or they are not as many
            as those of the cameras.
    """
    check_limits("tracking", limits_mm)
    expected_mm, light = _begun(of_points, pixels, expected_mm, light)
    prior = Prior(expected_mm, of_points.prior_std_mm)
    fit = refine(of_points, pixels, expected_mm, light, prior, 0)
    _, light, there = present(fit, pixels)
    if there.mean() < FEWEST:
        raise PlenoPIVError(ELSEWHERE)
    own = np.flatnonzero(there)
    lights = fit.carried(own, np.empty((0, 3)))
    begin = _Start(expected_mm[own], light[own], prior.of(own), lights, expected_mm, KNOWN_STEPS, KNOWN_PASSES)
    del fit
    return _in_passes(of_points, pixels, begin, limits_mm, progress)


def check_pixels(of_points: LightOfPoints, pixels: Pixels) -> None:
    """Raise PlenoPIVError where ``pixels`` are not those of the cameras."""
    check_number(len(pixels.counts), of_points.frame_pixels)


def _begun(of_points: LightOfPoints, pixels: Pixels, position_mm: Array, light: Array) -> tuple[Array, Array]:
    """Guesses of positions (n, 3) mm and light (n,) that are finite, neighbours near each other."""
    check_pixels(of_points, pixels)
    position_mm, light = as_points("tracking", position_mm), np.asarray(light, np.float64)
    if light.shape != (len(position_mm),):
        raise PlenoPIVError(f"tracking: light of shape {light.shape}, of {len(position_mm)} points; give one of each")
    known = np.isfinite(position_mm).all(1) & np.isfinite(light)
    position_mm, light = position_mm[known], light[known]
    if len(light) == 0:
        raise PlenoPIVError(NONE)
    order = in_order(position_mm[:, :2])
    return position_mm[order], light[order]


@dataclass(frozen=True)
class _Start:
    """Where passes begin: positions (n, 3) mm, light (n,) counts, the prior, and where light goes, None where it is not
    kept; ``known`` (m, 3) mm: places of which it is known whether a particle there is two; iterations of the first
    pass, and passes at most."""

    position_mm: Array
    light: Array
    prior: Prior
    lights: Lights | None
    known: Array
    steps: int
    passes: int


def _in_passes(
    of_points: LightOfPoints, pixels: Pixels, begin: _Start, limits_mm: Limits, progress: Progress | None
) -> FrameParticles:
    """Fit, leave out, split, and search while a search finds more than FEW, until hardly anything changes; then the
    last fit. The first fit is a rough one: nothing is judged by it but where light is left."""
    position, light, prior, lights, known = begin.position_mm, begin.light, begin.prior, begin.lights, begin.known
    image, given, all_found = None, pixels, False
    off = np.full(len(light), np.nan)  # misfits, of particles that have been looked at
    for done in range(begin.passes):
        steps, effort = (STEPS, ON_THE_WAY) if done else (begin.steps, FIRST)
        fit = refine(of_points, pixels, position, light, prior, steps, effort, lights, image, done)
        pixels = with_noise(given, fit.image)
        out, pairs, half = np.zeros(len(light), bool), np.empty(0, np.int64), np.empty((0, 3))
        if done:
            changed = np.flatnonzero(fit.moved | np.isnan(off))
            off[changed] = fit.told[changed, 0]
            most, asked = BEGUN * float(np.median(off)), changed[doubtful(fit, changed)]
            covariance, _ = errors_of(fit, pixels.usable, NEIGHBOURS, asked)
            out[asked] = without_evidence(fit, covariance, np.minimum(off[asked], most), which=asked)
            if out.all():
                raise PlenoPIVError(NONE)
            bright = crowded(fit, off) & ~(out | near_any(fit.position_mm, known, fit.unit_mm))
            bright[np.setdiff1d(np.arange(len(off)), changed)] = False
            pairs, half = splits(fit, off, bright)
            known = np.concatenate([known, fit.position_mm[bright]])
        typical = float(np.median(fit.light[~out]))
        places = np.empty((0, 3))
        if not all_found:
            excess = np.where(pixels.usable, fit.residual / np.sqrt(fit.variance), np.nan)
            places, _ = of_points.places(excess, limits_mm)
            all_found = done > 0 and len(places) <= FEW * len(light)
        if progress is not None:
            progress(done + 1, begin.passes + 1)
        changes, middle = len(places) + len(pairs) + out.sum(), fit.position_mm[pairs]
        out[pairs] = True
        new = np.concatenate([places, middle + half, middle - half])
        of_new = np.concatenate([np.full(len(places), FIRST_LIGHT * typical), np.tile(0.5 * fit.light[pairs], 2)])
        position, light = np.concatenate([fit.position_mm[~out], new]), np.concatenate([fit.light[~out], of_new])
        off = np.concatenate([off[~out], np.full(len(new), np.nan)])
        prior = Prior(np.concatenate([prior.position_mm[~out], new]), prior.std_mm)
        lights, image = fit.carried(np.flatnonzero(~out), new), None
        if lights is None:
            image = fit.image
            add_light(of_points, fit.position_mm[out], -fit.light[out], image)
            add_light(of_points, new, of_new, image)
        del fit
        if done and changes <= FEW * len(light):
            break
    fit = refine(of_points, pixels, position, light, prior, LAST_STEPS, LAST, lights, image)
    return judged(fit, pixels)[0]


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
