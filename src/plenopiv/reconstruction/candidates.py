"""Candidates: which voxels can hold a particle at all, and the light that MART starts with.

Plenoptic cameras: dense ray tracing (DRT; paper, section 3, Fig. 8). The paper multiplies the values of all pixels that
a voxel's rays reach and keeps the voxel where the product is not zero. But a particle of E counts does not only light
its pixels: it gives each of them at least w E. The least I / w over a voxel's pixels therefore bounds the light that it
can hold. A voxel stays where that bound, each pixel taken NOISE_MARGIN standard deviations of its noise brighter than
measured, reaches the faintest particle looked for. The product is the bound "> 0"; both are here (``"bound"``,
``"product"``). Of several cameras each judges by itself; what all of them keep stays.

Pinhole cameras: multiplied lines of sight (MLOS; Atkinson & Soria 2009). Voxels that are dark in any camera are left
out, the others start from the product of what the cameras show there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.noise import Noise
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.typical_particle import typical_particle
from plenopiv.sensor import at_full_scale
from plenopiv.volume import SparseVolume

LIT_MULTIPLE = 3.0  # a lit pixel stands this many standard deviations of the dark noise above the black level
BRIGHT_SHARE = 0.03  # and this share of what the image's bright pixels (90th percentile) hold
NOISE_MARGIN = 2.0  # standard deviations
LONE, CROWDED = 0.2, 0.4  # share of the typical particle that the faintest one holds, in the dark and in a crowd
CROWD = 0.3  # share of the pixels that are lit from which on particles crowd
CLEARLY = 2.0  # thresholds: noise alone does not reach so high
FEWEST_LIT = 1e-4  # share of such pixels below which a frame counts as empty
LIT_SHARE = 0.05  # of what the light's pixels hold on average: a lit pixel of a pinhole camera has more
SMALLEST_THRESHOLD = 1.0  # counts


@dataclass(frozen=True)
class Candidates:
    """The voxels that MART starts from.

    ``volume``: their values are the first guess of their light, or 1 where there is none. ``threshold`` counts, and
    ``particle`` counts of a typical particle in a pixel that it lights wholly in focus (0 where it was not measured),
    both the mean over cameras.
    """

    volume: SparseVolume
    threshold: float
    particle: float


class Judgement(NamedTuple):
    """What makes a voxel a candidate: a particle of ``lights`` counts, of each camera, gives no pixel more than
    ``most`` (view, pixel); ``most`` None for all voxels that the cameras see. ``threshold`` and ``particle`` as in
    ``Candidates``."""

    most: NDArray[np.float32] | None
    lights: Sequence[float]
    threshold: float
    particle: float


def find_candidates(
    values: NDArray[np.float32],
    projection: Projection,
    settings: ReconstructionSettings,
    noises: Sequence[Noise],
    name: str,
) -> Candidates:
    """The candidates of a frame ``values`` (view, pixel) in counts; ``noises``: of the pixels of each camera
    (``Projection.each_camera``).

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles, or the method is not one of these cameras.
    """
    most, lights, threshold, particle = judgement(values, projection, settings, noises, name)
    volume = projection.visible_voxels() if most is None else projection.candidates(most, lights)
    return Candidates(volume, threshold, particle)


def judgement(
    values: NDArray[np.float32],
    projection: Projection,
    settings: ReconstructionSettings,
    noises: Sequence[Noise],
    name: str,
) -> Judgement:
    """What makes a voxel a candidate of a frame; arguments and errors as of ``find_candidates``."""
    if settings.method == "mlos-mart":
        if not isinstance(projection, PinholeProjector):
            raise PlenoPIVError('reconstruction.method: "mlos-mart" is for pinhole cameras; use "drt-mart"')
        threshold = lit_above(values, noises[0]) if settings.threshold is None else settings.threshold
        return Judgement(values, [threshold], threshold, 0.0)
    limits = np.full(values.shape, np.inf, np.float32)
    rules = list[list[float]]()
    each = zip(projection.each_camera(values), projection.each_camera(limits), noises, strict=True)
    for number, ((projector, own), (_, most), noise) in enumerate(each, 1):
        if not isinstance(projector, PlenopticProjector):
            raise PlenoPIVError(f'reconstruction.method: "{settings.method}" is for plenoptic cameras; use "mlos-mart"')
        label = name if len(noises) == 1 else f"{name}, camera {number}"
        most[:], *rule = light_rule(LightField(projector.layout, own), projector, settings, noise, label)
        rules.append(rule)
    lights, thresholds, particles = zip(*rules, strict=True)
    judged = None if settings.method == "mart" else limits
    return Judgement(judged, lights, float(np.mean(thresholds)), float(np.mean(particles)))


class LightRule(NamedTuple):
    """What makes a voxel a candidate of one camera: a particle of ``light`` counts in it gives no pixel more than
    ``most`` (view, lens). ``threshold`` and ``particle`` as in ``Candidates``."""

    most: NDArray[np.float32] | np.float32
    light: float
    threshold: float
    particle: float


def light_rule(
    lightfield: LightField, projector: PlenopticProjector, settings: ReconstructionSettings, noise: Noise, name: str
) -> LightRule:
    """The rule of one plenoptic camera for the frame ``name``.

    Raises:
        PlenoPIVError: the frame shows no particles.
    """
    threshold = lit_threshold(lightfield, noise) if settings.threshold is None else settings.threshold
    clearly_lit = np.count_nonzero(lightfield.values > CLEARLY * threshold)
    if clearly_lit < FEWEST_LIT * np.count_nonzero(lightfield.layout.seen):
        raise PlenoPIVError(
            f"{name}: no particles: hardly a pixel is {CLEARLY * threshold:.0f} counts above the black level; "
            "check the exposure, sensor.black_level and reconstruction.threshold"
        )
    if settings.method == "mart":
        return LightRule(np.float32(np.inf), 0.0, threshold, 0.0)
    if settings.candidates == "product":
        return LightRule(dark_to_light(lightfield, threshold), 1.0, threshold, 0.0)
    particle = typical_particle(lightfield, projector, noise) * projector.light_in_focus
    if settings.threshold is None:
        threshold = max(faintest_share(lightfield, particle) * particle, threshold)
    return LightRule(most_light(lightfield, noise), threshold / projector.light_in_focus, threshold, particle)


def lit_threshold(lightfield: LightField, noise: Noise) -> float:
    """The count above which a pixel is taken as lit, at least 1."""
    bright = float(np.percentile(lightfield.values[lightfield.layout.seen], 90))
    return max(LIT_MULTIPLE * noise.dark, BRIGHT_SHARE * bright, 1.0)


def most_light(lightfield: LightField, noise: Noise) -> NDArray[np.float32]:
    """The most counts that each pixel (view, lens) may have collected; a saturated one any number."""
    saturated = at_full_scale(lightfield.values, lightfield.layout.camera.sensor)
    bound = np.maximum(lightfield.values, 0) + np.float32(NOISE_MARGIN) * noise.std(lightfield.values)
    bound[saturated] = np.inf
    return bound


def saturated_pixels(values: NDArray[np.float32], projection: Projection) -> NDArray[np.bool_]:
    """Which pixels (view, pixel) of one plenoptic camera are saturated; of pinhole cameras none is taken as such."""
    if not isinstance(projection, PlenopticProjector):
        return np.zeros(values.shape, bool)
    return at_full_scale(values, projection.layout.camera.sensor) & projection.seen


def dark_to_light(lightfield: LightField, threshold: float) -> NDArray[np.float32]:
    """The same for the paper's product: none where a pixel does not exceed ``threshold`` counts, else any number."""
    return np.where(lightfield.values > threshold, np.inf, 0.0).astype(np.float32)


def faintest_share(lightfield: LightField, particle: float) -> float:
    """Share of the typical particle that a voxel must be able to hold; ``particle``: its counts in a pixel that it
    lights wholly in focus.

    A particle's light is split among voxels: the more of them stay, the less is lost at its rim. Where few pixels are
    lit that costs nothing; in a crowd it keeps voxels between particles.
    """
    lit = float(np.mean(lightfield.values[lightfield.layout.seen] > LONE * particle))
    return LONE + (CROWDED - LONE) * min(lit / CROWD, 1.0)


def lit_above(values: NDArray[np.float32], noise: Noise) -> float:
    """The count above which a line of sight is lit: three times the dark noise, a twentieth of the light's mean pixel
    (sum I^2 / sum I, which does not depend on how many particles there are while they do not overlap), and 1 at
    least."""
    light = np.maximum(values, 0.0)
    mean = float(np.sum(light**2, dtype=np.float64)) / max(float(np.sum(light, dtype=np.float64)), 1.0)
    return max(LIT_MULTIPLE * noise.dark, LIT_SHARE * mean, SMALLEST_THRESHOLD)
