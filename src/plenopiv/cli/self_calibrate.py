"""``plenopiv selfcalibrate``: what the target left of a calibration, from particles."""

from __future__ import annotations

import warnings
from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment


def self_calibrate(file: Path) -> Outcome:
    """Correct the calibration, and say by how much and what was not fitted.

    Raises:
        PlenoPIVError: the experiment file or its images cannot be used, or there is no target.
    """
    from plenopiv.run.self_calibrate import self_calibrate

    with Progress() as progress:
        found = self_calibrate(Experiment.load(file), progress)
    before, after = found.chi2
    lines = [
        f"{found.particles} particles; {found.steps} steps",
        f"views fall beside the calibration by {found.rms_um:.2f} um RMS on the microlens plane, +- {found.std_um:.2f}",
        f"chi^2 per lit pixel of the other frame: {before:.3f}, with the correction {after:.3f}",
        f"{found.fitted} combinations of polynomials were fitted; {found.hidden} that no particle tells, among them a "
        "shift of all, a scale and a shift of depth, stay as the target has them",
    ]
    if not found.settled:
        words = f"{found.file}: the last of {found.steps} steps still changed the views by {found.last_um:.2f} um RMS"
        advice = "the correction is known no better than that; more light or particles, and a calibration nearer to it"
        warnings.warn(f"{words}: {advice}", PlenoPIVWarning, stacklevel=2)
    if found.shift is None:
        lines.append(f"nothing is gained: {found.file} stays as it was")
    else:
        lines.append(f"{found.file}: corrected; plenopiv run uses it, results of before take --overwrite")
    facts = {
        "corrected": found.shift is not None,
        "rms_um": found.rms_um,
        "std_um": found.std_um,
        "steps": found.steps,
        "last_step_um": found.last_um,
        "settled": found.settled,
        "chi2": list(found.chi2),
        "particles": found.particles,
        "fitted": found.fitted,
        "hidden": found.hidden,
        "file": str(found.file),
    }
    return Outcome("\n".join(lines), facts)
