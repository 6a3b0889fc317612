"""The map between an experiment's laboratory and lens space."""

from __future__ import annotations

import warnings

from plenopiv.cameras.coverage import coverage
from plenopiv.cameras.lens_space import behind_window, space_map
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment, in_view
from plenopiv.reconstruction.resampling import lens_grid
from plenopiv.recording import Recording
from plenopiv.run.target import target_calibration
from plenopiv.volume import VoxelGrid

MOST_UNSEEN = 0.5  # share of a volume of the laboratory that no view may see


def space_of(experiment: Experiment, recording: Recording) -> SpaceMap | None:
    """The map: of the camera calibrated with the target of [calibration], else through the window and fluid of
    [medium]. None where x, y, z are those of the camera, a thin lens in air.

    Raises:
        PlenoPIVError: the camera cannot be calibrated, or fluid and window leave no air before the main lens.
    """
    limits, table = experiment.grid().limits_mm(), experiment.calibration
    calibration = target_calibration(experiment, recording)
    if calibration is not None and table is not None:
        return calibration.space(limits, table.origin_mm, table.turn_deg)
    if experiment.medium is None:
        return None
    camera = experiment.camera()
    return space_map(behind_window(camera, experiment.medium.medium()), camera, limits)


def grid_of(experiment: Experiment, space: SpaceMap | None) -> VoxelGrid:
    """The voxels that are reconstructed: of [volume], or those of lens space that cover its image."""
    grid = experiment.grid()
    return grid if space is None else lens_grid(space, grid)


def check_view(experiment: Experiment, camera: PlenopticCamera, space: SpaceMap | None) -> None:
    """Refuse a volume of the laboratory that ``camera`` cannot measure, and warn where it sees less of it: where the
    camera looks is only known now. In the camera's own frame the experiment file has been checked by itself.

    Raises:
        PlenoPIVError: it is not in front of the main lens, or no view sees as much as half of it.
    """
    if space is None:
        return
    volume = experiment.volume
    if lines := in_view.behind_lens(volume, camera, space):
        raise PlenoPIVError(f"{experiment.path}: {lines[0]}")
    if lines := in_view.unseen(volume, camera, space):
        if coverage(camera, experiment.grid().limits_mm(), space=space).no_view > MOST_UNSEEN:
            raise PlenoPIVError(f"{experiment.path}: {lines[0]}")
        warnings.warn(lines[0], PlenoPIVWarning, stacklevel=3)
    for line in in_view.warnings(volume, experiment.correlation, camera, space):
        warnings.warn(line, PlenoPIVWarning, stacklevel=3)
