"""From an experiment and its white image to a calibrated camera, and the chain that measures with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import degrees
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration import LatticeFit, find_lattice
from plenopiv.calibration.target.calibrated import TargetCalibration
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.chain import Chain
from plenopiv.displacement.solid import Solid
from plenopiv.experiment import Experiment
from plenopiv.lightfield import decode, layout
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, counts_per_electron
from plenopiv.recording import Recording
from plenopiv.recording.background import static_light_of_frames
from plenopiv.run.drift import with_drift
from plenopiv.run.lens_blur import with_blur
from plenopiv.run.solid import solid_of
from plenopiv.run.target import target_calibration
from plenopiv.sensor import middle, middle_of

MIDDLE_PX = 1600  # side of the sensor's middle, in which shot noise is measured at first
LIT = 0.5  # of the white image's bright pixels: pixels under microlenses

Progress = Callable[[int, int], None]


def calibrated_camera(
    experiment: Experiment,
    recording: Recording,
    fit: LatticeFit | None = None,
    target: TargetCalibration | None = None,
) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The camera of lens space with its lattice: as the target shows both, or the lattice as the white image shows it,
    or as the file states it; and how well that fits. ``fit``: of the white image, ``target``: of the camera with a
    target, where they were found before.

    Raises:
        PlenoPIVError: the white image cannot be used, or shows no lattice like the camera's.
    """
    if (calibration := target or target_calibration(experiment, recording, fit)) is not None:
        lattice, seen = calibration.camera.lattice, [plane for plane in calibration.planes if plane.whole]
        camera = replace(calibration.camera, blur_mm=experiment.camera().blur_mm)
        squares, dots = np.square([plane.rms_um for plane in seen]), [plane.whole for plane in seen]
        return camera, {
            "lattice": lattice.kind,
            "pitch_mm": lattice.pitch_mm,
            "rotation_deg": degrees(lattice.rotation_rad),
            "offset_mm": lattice.offset_mm,
            "target_residual_um": np.sqrt(np.average(squares, axis=0, weights=dots)).tolist(),
            "target_dots": sum(dots),
        }
    camera, white = experiment.camera(), recording.white()
    if white is None:
        return camera, {"lattice": "as stated in the experiment file"}
    fit = fit or find_lattice(white, camera, str(recording.white_path))
    return replace(camera.with_lattice(fit.lattice), rim=fit.rim), {
        "lattice": fit.lattice.kind,
        "pitch_mm": fit.lattice.pitch_mm,
        "rotation_deg": fit.rotation_deg,
        "offset_mm": fit.offset_mm,
        "residual_px": fit.residual_px,
        "microlenses": fit.microlenses,
    }


def calibrated_chain(
    experiment: Experiment,
    recording: Recording,
    fit: LatticeFit | None = None,
    progress: Progress | None = None,
    space: SpaceMap | None = None,
    target: TargetCalibration | None = None,
    before: Mapping[str, Any] | None = None,
) -> tuple[Chain, Recording, dict[str, Any]]:
    """The chain of an experiment, shot noise measured on the white image; the recording, with its static light where
    that was to be estimated from the frames; and what was found in calibration. ``space``: as ``space_of`` gives it;
    ``target``: as ``target_calibration`` does; ``before``: what was found when finished pairs were measured, as
    ``with_drift`` takes it.

    Raises:
        PlenoPIVError: as ``calibrated_camera`` and ``solid_of``; static light cannot be estimated.
    """
    solid = solid_of(experiment)
    camera, found = calibrated_camera(experiment, recording, fit, target)
    if recording.background_of_frames:
        recording, found["static_light"] = with_static_light(recording, camera, progress)
    of_white = camera
    if experiment.drift_measured:
        camera, of_array = with_drift(camera, recording, before)
        found |= of_array
    chain = chain_of(experiment, camera, recording.unusable, solid, space)
    if experiment.blur_measured:
        camera, of_lens = with_blur(chain, recording)
        found |= of_lens
        chain = chain_of(experiment, camera, recording.unusable, solid, space)
    where, white = chain.layout, recording.white()  # the projection is made now, the layout once
    if white is None:
        return chain, recording, found
    if of_white.lattice != camera.lattice:
        where = layout(of_white, recording.unusable)
    return chain.with_noise(counts_per_electron(decode(white, where))), recording, found


def chain_of(
    experiment: Experiment,
    camera: PlenopticCamera,
    unusable: NDArray[np.bool_] | None,
    solid: Solid | None,
    space: SpaceMap | None = None,
) -> Chain:
    """The chain of an experiment and its calibrated ``camera``, of unknown noise. ``unusable``: pixels (rows, columns)
    that are no equations; ``solid``: what a body fills; ``space``: between the laboratory and lens space. A blur of the
    camera and few pixels per microlens take more iterations (``ReconstructionSettings.through``)."""
    reconstruction = experiment.reconstruction.settings().through(camera)
    correlation = experiment.correlation.settings()
    masks = () if unusable is None else (unusable,)
    return Chain((camera,), experiment.grid(), reconstruction, correlation, unusable=masks, solid=solid, space=space)


def with_static_light(
    recording: Recording, camera: PlenopticCamera, progress: Progress | None = None
) -> tuple[Recording, dict[str, Any]]:
    """The recording with static light estimated from its frames, and how well; ``camera`` with its lattice.

    Raises:
        PlenoPIVError: too few frames for their seeding, or one cannot be used.
    """
    sensor, white = recording.sensor, recording.white()
    dark, hot = recording.dark_level()
    gain, lit = NO_WHITE_IMAGE, np.ones(dark.shape, bool)
    if white is not None:
        part = middle(sensor, MIDDLE_PX, MIDDLE_PX)
        gain = counts_per_electron(decode(middle_of(white, part), layout(replace(camera, sensor=part))))
        lit = white - dark > LIT * np.percentile(white - dark, 90)
    if recording.masked is not None:
        lit = lit & ~recording.masked
    found, estimates = static_light_of_frames(
        recording.frame, recording.frames_of_pulses(), sensor, dark, gain, hot, lit, progress
    )
    stated = {
        "frames": estimates[0].frames,
        "error_counts": estimates[0].error_counts,
        "particle_light_left_counts": estimates[0].left_counts,
        "particle_light_counts": estimates[0].particles_counts,
    }
    return recording.with_static_light(found), stated
