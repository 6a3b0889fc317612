"""From an experiment and its white image to a calibrated camera, and the chain that measures with it."""

from __future__ import annotations

from typing import Any

from plenopiv.calibration import find_lattice
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.experiment import Experiment
from plenopiv.lightfield import decode
from plenopiv.reconstruction.noise import counts_per_electron
from plenopiv.recording import Recording


def calibrated_camera(experiment: Experiment, recording: Recording) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The camera with its lattice as the white image shows it, or as the file states it, and how well that fits.

    Raises:
        PlenoPIVError: the white image cannot be used, or shows no lattice like the camera's.
    """
    camera, white = experiment.camera(), recording.white()
    if white is None:
        return camera, {"lattice": "as stated in the experiment file"}
    fit = find_lattice(white, camera, str(recording.white_path))
    return camera.with_lattice(fit.lattice), {
        "lattice": fit.lattice.kind,
        "pitch_mm": fit.lattice.pitch_mm,
        "rotation_deg": fit.rotation_deg,
        "offset_mm": fit.offset_mm,
        "residual_px": fit.residual_px,
        "microlenses": fit.microlenses,
    }


def calibrated_chain(experiment: Experiment, recording: Recording) -> tuple[Chain, dict[str, Any]]:
    """The chain of an experiment, shot noise measured on the white image, and what was found in calibration.

    Raises:
        PlenoPIVError: as ``calibrated_camera``.
    """
    camera, found = calibrated_camera(experiment, recording)
    reconstruction, correlation = experiment.reconstruction.settings(), experiment.correlation.settings()
    static = recording.static_light
    unusable = () if static is None else (static.unusable,)
    chain = Chain((camera,), experiment.grid(), reconstruction, correlation, unusable=unusable)
    where, white = chain.layout, recording.white()  # the projection is made now, the layout once
    return (chain if white is None else chain.with_noise(counts_per_electron(decode(white, where)))), found
