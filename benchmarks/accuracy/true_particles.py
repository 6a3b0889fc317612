"""A recording's field against the particles that it was simulated from."""

from __future__ import annotations

import numpy as np
import xarray as xr

from plenopiv.accuracy import Score, score_velocity
from plenopiv.experiment import Experiment


def scored(velocity: xr.Dataset, experiment: Experiment) -> Score:
    """Score the field of a recording's only pair against ``truth_particles.npz`` beside its experiment file.

    Raises:
        PlenoPIVError: no vector can be judged.
    """
    with np.load(experiment.folder / "truth_particles.npz") as particles:
        return score_velocity(
            velocity,
            particles["a"],
            particles["b"],
            experiment.camera(),
            dt_s=experiment.recording_table.dt_s,
            voxel_mm=experiment.volume.voxel_mm,
            window_voxels=experiment.correlation.windows[-1],
        )
