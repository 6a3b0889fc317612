"""The one type of this stage: displacements in voxels on a grid of interrogation windows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray


NEAR_FACE = 0.75  # of a window's depth


@dataclass(frozen=True)
class DisplacementField:
    """Displacement from the first volume to the second, in voxels, at mid-time positions.

    ``z``, ``y``, ``x``: window centres as voxel indices (the centre of voxel k is k), float64, ascending.
    ``displacement``: (3, nz, ny, nx) float64, components dx, dy, dz, after validation and replacement; finite.
    ``raw``: the displacement of the last pass before replacement, same shape; 0 where a window held no light. With
    sub-windows it differs from ``displacement`` in replaced windows only: there it is the mean of the sub-windows' raw
    vectors, outliers included.
    ``valid``: (nz, ny, nx), True = measured, False = replaced from neighbours. With sub-windows: True where more than
    half of the window's mean comes from measured sub-windows.
    ``peak_ratio``: (nz, ny, nx) float32, highest correlation peak over the second highest; 0 without a peak.
    With sub-windows the inverse of the mean inverse over the window.
    ``std``: (3, nz, ny, nx) float64, standard deviation of ``displacement`` (dx, dy, dz) in voxels, finite; see
    ``displacement.uncertainty`` for what it covers.
    ``solid``: (nz, ny, nx), windows more than half in a solid body, which were not measured: there ``displacement``,
    ``raw``, ``peak_ratio`` and ``std`` are NaN and ``valid`` is False. None where no body was named.
    """

    z: NDArray[np.float64]
    y: NDArray[np.float64]
    x: NDArray[np.float64]
    displacement: NDArray[np.float64]
    raw: NDArray[np.float64]
    valid: NDArray[np.bool_]
    peak_ratio: NDArray[np.float32]
    std: NDArray[np.float64]
    solid: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        counts = " x ".join(map(str, self.valid.shape[::-1]))
        return f"<DisplacementField {counts} vectors (x, y, z) in voxels, {int((~self.valid).sum())} replaced>"

    def without(self, solid: NDArray[np.bool_]) -> DisplacementField:
        """The same, the vectors of ``solid`` windows (nz, ny, nx) not measured."""
        each = {name: np.where(solid, np.nan, getattr(self, name)) for name in ("displacement", "raw", "std")}
        ratio = np.where(solid, np.float32(np.nan), self.peak_ratio)
        return replace(self, **each, valid=self.valid & ~solid, peak_ratio=ratio, solid=solid)

    def as_xarray(self) -> xarray.Dataset:
        """The same as a dataset on (z, y, x), voxel indices: dx, dy, dz, their _raw and _std in voxels per frame,
        valid, peak_ratio."""
        import xarray

        dims, voxels = ("z", "y", "x"), {"units": "voxel"}
        held: dict = {}
        for end, values in (("", self.displacement), ("_raw", self.raw), ("_std", self.std)):
            held |= {f"d{axis}{end}": (dims, values[k], voxels) for k, axis in enumerate("xyz")}
        held |= {"valid": (dims, self.valid), "peak_ratio": (dims, self.peak_ratio, {"units": "1"})}
        axes = {axis: (axis, getattr(self, axis), voxels) for axis in dims}
        return xarray.Dataset(held, axes)


def near_face(z: NDArray[np.float64], planes: int, deep: int) -> NDArray[np.bool_]:
    """Which windows ``deep`` voxels deep have their middles, at the voxel indices ``z``, less than NEAR_FACE of that
    from the front or the back of a volume of so many ``planes``: particles enter and leave there between the frames."""
    return np.asarray(np.minimum(z + 0.5, planes - 0.5 - z) < NEAR_FACE * deep)
