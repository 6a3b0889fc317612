"""The map between an experiment's laboratory and lens space."""

from __future__ import annotations

import warnings

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment, in_view
from plenopiv.reconstruction.resampling import lens_grid
from plenopiv.recording import Recording
from plenopiv.volume import VoxelGrid


def space_of(experiment: Experiment, recording: Recording) -> SpaceMap | None:
    """The map; None where x, y, z are those of the camera, a thin lens in air."""
    return None


def grid_of(experiment: Experiment, space: SpaceMap | None) -> VoxelGrid:
    """The voxels that are reconstructed: of [volume], or those of lens space that cover its image."""
    grid = experiment.grid()
    return grid if space is None else lens_grid(space, grid)


def check_view(experiment: Experiment, camera: PlenopticCamera, space: SpaceMap | None) -> None:
    """Refuse a volume of the laboratory that ``camera`` cannot measure, and warn where it sees less of it. Without a
    target the experiment file has been checked by itself.

    Raises:
        PlenoPIVError: it is not in front of the main lens, or no view sees a part of it.
    """
    if space is None and experiment.calibration is None:
        return
    volume = experiment.volume
    for line in in_view.behind_lens(volume, camera, space) or in_view.unseen(volume, camera, space):
        raise PlenoPIVError(f"{experiment.path}: {line}")
    for line in in_view.warnings(volume, experiment.correlation, camera, space):
        warnings.warn(line, PlenoPIVWarning, stacklevel=3)
