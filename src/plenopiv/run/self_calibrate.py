"""What the target left of a calibration, from the particles of a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.space_map import ViewShift
from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import save_calibration
from plenopiv.recording import Recording
from plenopiv.run import target as of_target
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.track_frame import FrameTracker
from plenopiv.tracking import ray_shifts
from plenopiv.tracking.light import WAVELENGTH_NM, PointLights, diffraction_px, prior_std_mm
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, fit_light, refine

STEPS = 5
FIRST, THEN = 5, 3  # Gauss-Newton iterations of the particles alone before a step, the first one and those after it
STILL = 0.1  # of the shift: a step that changes it by less, or by less than its standard deviation, is the last
HELPS = 0.003  # share by which chi^2 of the other frame must fall
FEWEST = 200  # particles
LARGEST = 16.0  # chi^2 of a pixel, as light of a particle that was not found

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Seen:
    """A frame: its pixels, and where particles are first seen in it, (n, 3) mm of lens space, with their light."""

    pixels: Pixels
    position_mm: Array
    light: Array


@dataclass(frozen=True)
class SelfCalibration:
    """What was found: the calibration ``file``; ``shift``, None where particles ask for none; its RMS over all rays and
    standard deviation, um, by ``steps``; ``chi2`` per lit pixel of the frame that had no part in the fit, before and
    after; how many combinations of the polynomials were ``fitted``, and how many no particle tells, ``hidden``."""

    file: Path
    shift: ViewShift | None
    rms_um: float
    std_um: float
    steps: int
    chi2: tuple[float, float]
    particles: int
    fitted: int
    hidden: int


def self_calibrate(experiment: Experiment, progress: Progress | None = None) -> SelfCalibration:
    """Fit what the target left to the particles of the first pair's first frame, judge it by the second one, and write
    it into calibration.toml, where runs find it; an earlier one is gone on from.

    Raises:
        PlenoPIVError: there is no target, a frame cannot be used, or too few particles are seen.
    """
    report = progress or (lambda stage, done, total: None)
    table = experiment.calibration
    if table is None:
        raise PlenoPIVError(f"{experiment.path}: self-calibration starts from a target: [calibration] is missing")
    recording = experiment.recording()
    target = of_target.target_calibration(experiment, recording, progress=report)
    assert target is not None
    space = target.space(experiment.grid().limits_mm(), table.origin_mm, table.turn_deg)
    chain, recording, _ = calibrated_chain(experiment, recording, None, None, space, target)
    wavelength = WAVELENGTH_NM if experiment.tracking is None else experiment.tracking.wavelength_nm
    first, second = recording.first_readable_pair()[0]
    report("self-calibration", 0, STEPS + 2)
    seen = _seen(chain, recording, first, wavelength)
    if len(seen.light) < FEWEST:
        raise PlenoPIVError(
            f"{recording.frames[first].name}: {len(seen.light)} particles are seen, self-calibration needs {FEWEST}: "
            "more particles or light"
        )
    blur = diffraction_px(chain.camera, wavelength)

    def lights(shift: ViewShift | None) -> PointLights:
        return PointLights(chain.camera, blur, together(space.left, shift), space.growth)

    terms = ray_shifts.visible_terms(chain.camera, seen.position_mm)
    amounts, rms, std, done = np.zeros(terms.visible.shape[1]), 0.0, 0.0, 0
    position, light = seen.position_mm, fit_light(lights(None)(seen.position_mm), seen.pixels, seen.light)
    prior = Prior(seen.position_mm, prior_std_mm(chain.camera))
    for done in range(1, STEPS + 1):
        of_points = lights(terms.shift(amounts) if amounts.any() else None)
        how = (terms, amounts, THEN if done > 1 else FIRST)
        found = ray_shifts.step(of_points, seen.pixels, position, light, prior, *how)
        change = float(np.linalg.norm(found.amounts_um - amounts))
        position, light, amounts, rms, std = (
            found.position_mm, found.light, found.amounts_um, found.rms_um, found.std_um,
        )  # fmt: skip
        report("self-calibration", done, STEPS + 2)
        if change < max(STILL * rms, std):
            break
    shift: ViewShift | None = terms.shift(amounts)
    other = _seen(chain, recording, second, wavelength)
    chi2 = _misfit(lights(None), other), _misfit(lights(shift), other)
    if chi2[1] > (1 - HELPS) * chi2[0]:
        shift = None
    path = experiment.folder / of_target.FILE
    beside = together(target.beside, shift)
    save_calibration(replace(target, beside=beside), of_target.inputs_of(experiment, recording), path)
    report("self-calibration", STEPS + 2, STEPS + 2)
    fitted, hidden = terms.visible.shape[1], terms.hidden
    return SelfCalibration(path, shift, rms, std, done, chi2, len(light), fitted, hidden)


def _seen(chain: Chain, recording: Recording, number: int, wavelength_nm: float) -> Seen:
    """Frame ``number``, reconstructed."""
    tracker = FrameTracker(chain, recording, wavelength_nm)
    image, static = recording.light(number)
    behind = None if static is None else [static]
    made = chain.reconstruct([image], recording.frames[number].name, static=behind)
    pixels = tracker.pixels(image, made.noise.dark, static)
    return Seen(pixels, *peaks(made.volume))


def _misfit(of_points: PointLights, seen: Seen) -> float:
    """chi^2 per lit pixel of particles fitted to a frame."""
    light = fit_light(of_points(seen.position_mm), seen.pixels, seen.light)
    prior = Prior(seen.position_mm, of_points.prior_std_mm)
    fit = refine(of_points, seen.pixels, seen.position_mm, light, prior, FIRST)
    lit = np.zeros(fit.residual.size, bool)
    lit[fit.lights.pixel] = True
    lit &= seen.pixels.usable
    return float(np.mean(np.minimum(fit.residual[lit] ** 2 / fit.variance[lit], LARGEST)))


def together(one: ViewShift | None, other: ViewShift | None) -> ViewShift | None:
    """Both shifts; None where there is neither."""
    if one is None or other is None:
        return other if one is None else one
    return one.plus(other)
