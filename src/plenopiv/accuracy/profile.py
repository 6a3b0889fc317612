"""Errors of a velocity field against a known flow, plane by plane: with one camera the error depends on depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.accuracy.velocity import GROSS_VOXELS

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DepthProfile:
    """Errors by depth: ``z_mm`` (n,) of the planes of vectors; ``rms`` and ``bias`` (3, n), voxels per frame along x,
    y, z, NaN where a plane has no measured vector; ``vectors`` (n,) that were judged."""

    z_mm: Array
    rms: Array
    bias: Array
    vectors: NDArray[np.int64]


def error_by_depth(
    dataset: xarray.Dataset,
    truth: Callable[[Array], Array],
    voxel_mm: tuple[float, float, float],
    dt_s: float,
    time: int = 0,
) -> DepthProfile:
    """Errors of the measured vectors of one time, dims (time, z, y, x), at each z.

    ``truth``: velocity in m/s at (n, 3) mm. Replaced vectors and gross errors (above ``GROSS_VOXELS`` on any axis) are
    left out.
    """
    field = dataset.isel(time=time)
    z, y, x = np.meshgrid(*(dataset[axis].values for axis in "zyx"), indexing="ij")
    true = truth(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*z.shape, 3)
    measured = np.stack([field[name].transpose("z", "y", "x").values for name in "uvw"], -1)
    error = (measured - true) * 1e3 * dt_s / np.asarray(voxel_mm)
    with np.errstate(invalid="ignore"):
        judged = (field["valid"].transpose("z", "y", "x").values == 1) & (np.abs(error) <= GROSS_VOXELS).all(-1)
    rms, bias = np.full((2, 3, z.shape[0]), np.nan)
    for k, inside in enumerate(judged):
        if inside.any():
            rms[:, k] = np.sqrt((error[k][inside] ** 2).mean(0))
            bias[:, k] = error[k][inside].mean(0)
    return DepthProfile(dataset["z"].values.astype(float), rms, bias, judged.sum((1, 2)))
