"""What the target left of a calibration, from the particles of a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plenopiv.cameras.space_map import ViewShift
from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import save_calibration
from plenopiv.recording import Recording
from plenopiv.run import target as of_target
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.track_frame import FrameTracker
from plenopiv.tracking.light import WAVELENGTH_NM, diffraction_px, prior_std_mm
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.ray_shifts import RayShifts, together, visible_terms
from plenopiv.tracking.with_calibration import HELPS, STEPS, Seen, misfit, settle

FEWEST = 200  # particles

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class SelfCalibration:
    """What was found: the calibration ``file``; ``shift``, None where particles ask for none; its RMS over all rays and
    standard deviation, um, by ``steps``, of which the last changed it by ``last_um``, and ``settled`` says whether that
    is little; ``chi2`` per lit pixel of the frame that had no part in the fit, before and
    after; how many combinations of the polynomials were ``fitted``, and how many no particle tells, ``hidden``."""

    file: Path
    shift: ViewShift | None
    rms_um: float
    std_um: float
    steps: int
    last_um: float
    settled: bool
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
    terms = visible_terms(chain.camera, seen.position_mm)
    shifts = RayShifts(chain.camera, terms, diffraction_px(chain.camera, wavelength), space.left, space.growth)
    found, steps = settle(
        shifts, seen, prior_std_mm(chain.camera), lambda done: report("self-calibration", done, STEPS + 2)
    )
    shift: ViewShift | None = terms.shift(found.amounts)
    other = _seen(chain, recording, second, wavelength)
    chi2 = misfit(shifts.lights(np.zeros(shifts.count)), other), misfit(shifts.lights(found.amounts), other)
    if chi2[1] > (1 - HELPS) * chi2[0]:
        shift = None
    path = experiment.folder / of_target.FILE
    beside = together(target.beside, shift)
    save_calibration(replace(target, beside=beside), of_target.inputs_of(experiment, recording), path)
    report("self-calibration", STEPS + 2, STEPS + 2)
    particles = len(seen.light)
    of_steps = found.rms, found.std, steps, found.change, found.settled
    return SelfCalibration(path, shift, *of_steps, chi2, particles, shifts.count, terms.hidden)


def _seen(chain: Chain, recording: Recording, number: int, wavelength_nm: float) -> Seen:
    """Frame ``number``, reconstructed."""
    tracker = FrameTracker(chain, recording, wavelength_nm)
    image, static = recording.light(number)
    behind = None if static is None else [static]
    made = chain.reconstruct([image], recording.frames[number].name, static=behind)
    pixels = tracker.pixels(image, made.noise.dark, static)
    return Seen(pixels, *peaks(made.volume))
