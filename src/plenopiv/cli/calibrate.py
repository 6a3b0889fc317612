"""``plenopiv calibrate``: the lattice of microlenses from the white image."""

from __future__ import annotations

from pathlib import Path

from plenopiv.calibration import find_lattice, save_lattice
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

FILE = "lattice.toml"


def calibrate(file: Path, overwrite: bool) -> str:
    """Find the lattice, save it beside the experiment file; returns a summary of the fit.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, there is no white image, no lattice is found in it,
            or the lattice file is already there.
    """
    experiment = Experiment.load(file)
    recording = experiment.recording()
    white = recording.white()
    if white is None:
        raise PlenoPIVError(f"{file}: recording.white is missing; a calibration needs the white image")
    target = experiment.folder / FILE
    if target.exists() and not overwrite:
        raise PlenoPIVError(f"{target}: is already there; use --overwrite to replace it")
    fit = find_lattice(white, experiment.camera(), str(recording.white_path))
    save_lattice(fit, target)
    s, t = fit.offset_mm
    return "\n".join(
        [
            f"lattice    {fit.lattice.kind}, {fit.microlenses} microlenses, {fit.rejected} left out",
            f"pitch      {1e3 * fit.lattice.pitch_mm:.4f} um; micro-images every {fit.image_pitch_px:.5f} px",
            f"rotation   {fit.rotation_deg:+.4f} deg, counter-clockwise in (s, t)",
            f"array      {fit.map_words}; rows {100 * -fit.stretch:+.4f} % further apart than lenses along them, "
            f"{1e3 * fit.shear_rad:+.3f} mrad off a right angle",
            f"offset     s = {1e3 * s:+.2f} um, t = {1e3 * t:+.2f} um",
            f"residual   {fit.residual_px:.3f} px RMS, {fit.worst_px:.3f} px at 99.9 %, "
            f"{fit.worst_region_px:.3f} px in the worst region",
            f"saved      {target}",
        ]
    )
