"""The body of an experiment, and the vectors that it leaves to be measured."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from plenopiv.body import Body, read_body
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid, block_of, vectors_in
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.volume import VoxelGrid


def solid_of(experiment: Experiment) -> Solid | None:
    """The parts of the volume that ``volume.body`` fills; None without one.

    Raises:
        PlenoPIVError: the file cannot be used, no part of the volume lies in the body, or no vector is left.
    """
    if experiment.volume.body is None:
        return None
    path, grid, correlation = experiment.folder / experiment.volume.body, experiment.grid(), experiment.correlation
    body, settings = read_body(path), correlation.settings()
    solid = solid_in(body, grid, settings)
    if not solid.inside.any():
        raise PlenoPIVError(
            f"{path}: no part of the volume lies in it; it spans {_spans(zip(*body.limits_mm, strict=True))}, the "
            f"volume {_spans(grid.limits_mm())}; is it in mm, in the frame of the volume?"
        )
    if vectors_in(solid, grid.shape, settings).all():
        raise PlenoPIVError(f"{path}: every vector lies in it; volume.body is the solid, not the fluid around it")
    return solid


def solid_in(body: Body, grid: VoxelGrid, settings: CorrelationSettings) -> Solid:
    """Which blocks of a grid's voxels lie in a body."""
    block = block_of(settings)
    z, y, x = (
        _centres(count, size, first, voxel)
        for count, size, first, voxel in zip(grid.shape, block, grid.first_mm[::-1], grid.voxel_mm[::-1], strict=True)
    )
    return Solid(body.holds(x, y, z), block)


def _centres(count: int, size: int, first_mm: float, voxel_mm: float) -> NDArray[np.float64]:
    """Centres in mm of blocks of ``size`` voxels, the last one of those that are left."""
    low = np.arange(0, count, size)
    return np.asarray(first_mm + voxel_mm * 0.5 * (low + np.minimum(low + size, count) - 1), np.float64)


def _spans(limits: Iterable[tuple[float, float]]) -> str:
    """Limits along x, y and z as text."""
    return ", ".join(f"{axis} {lo:.4g} to {hi:.4g}" for axis, (lo, hi) in zip("xyz", limits, strict=True)) + " mm"
