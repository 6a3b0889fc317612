"""The velocity field of a pair's tracks, with the names of velocity.nc."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import Links
from plenopiv.tracking.parts import field_on_grid
from plenopiv.velocity import OF_TRACKS, velocity_dataset

if TYPE_CHECKING:
    import xarray

RAW = "no windows and no outliers replaced: the same as without _raw"
STD = "scatter of fits to tracks with errors of their size, and flow that they do not resolve, by tracks held out"

Array = NDArray[np.float64]


def of_links(first: FrameParticles, second: FrameParticles, links: Links) -> tuple[Array, Array, Array]:
    """Positions (n, 3) mm and velocities (n, 3) mm per frame, with standard deviations (n, 3), in the middle of each
    linked particle's way between two frames."""
    a, b = first.position_mm[links.a], second.position_mm[links.b]
    both = first.covariance[links.a] + second.covariance[links.b]
    return 0.5 * (a + b), b - a, np.sqrt(np.einsum("nii->ni", both)[:, :3])


def velocity_of_tracks(
    tracks: tuple[Array, Array, Array],
    chain: Chain,
    table: TrackingTable,
    dt_s: float,
    time_s: float,
    progress: Callable[[int, int], None] | None = None,
) -> xarray.Dataset:
    """The field of the ``tracks`` between two frames ``dt_s`` apart (``of_links``), as ``velocity_dataset`` makes it,
    without peak_ratio: splines on ``grid_mm``, through velocities at the middle of each particle's way.

    ``valid`` is 0 where no track is nearby; u, v, w are NaN there if the whole part has none.

    Raises:
        PlenoPIVError: too few tracks for a field.
    """
    position, moving, std = tracks
    rate = 1e-3 / dt_s  # mm per frame -> m/s
    limits, voxel = chain.grid.limits_mm(), np.asarray(chain.grid.voxel_mm)
    step = table.grid_mm or 0.5 * float(np.min(np.asarray(chain.correlation.windows[-1]) * voxel))
    x, y, z = (_axis(lo, hi, step) for lo, hi in limits)
    found = field_on_grid(
        position,
        moving * rate,
        std * rate,
        limits,
        (x, y, z),
        divergence_free=table.divergence_free,
        progress=progress,
    )
    to_voxels = 1.0 / (np.reshape(voxel, (3, 1, 1, 1)) * rate)
    moved, spread = found.velocity * to_voxels, found.std * to_voxels
    index = [(axis - lo) / d for axis, lo, d in zip((x, y, z), chain.grid.first_mm, voxel, strict=True)]
    ratio = np.zeros(found.measured.shape, np.float32)
    field = DisplacementField(index[2], index[1], index[0], moved, moved, found.measured, ratio, spread)
    out = velocity_dataset(field, chain.grid, dt_s, time_s, chain.frame).drop_vars("peak_ratio")
    out.attrs |= {
        "title": "Volumetric velocity from particle tracks of one plenoptic camera",
        "source": "PlenoPIV, particles from raw pixels, B-splines through their links",
        "links": len(position),
        "nodes_mm": found.step_mm,
        OF_TRACKS: int(table.divergence_free),
        "smoothing": list(found.smoothing),
        "error_scale": list(found.scale),
        "links_left_out": found.left_out,
    }
    for name in "uvw":
        out[f"{name}_std"].attrs["comment"] = STD
        out[name].attrs["long_name"] = f"velocity along {'xyz'['uvw'.index(name)]}"
        out[f"{name}_raw"].attrs["long_name"] = f"velocity along {'xyz'['uvw'.index(name)]}"
        out[f"{name}_raw"].attrs["comment"] = RAW
    out["valid"].attrs |= {"long_name": "tracks nearby or none", "flag_meanings": "extrapolated measured"}
    return out


def _axis(low: float, high: float, step: float) -> Array:
    """Points ``step`` apart, centred between two faces."""
    count = max(int(np.floor((high - low) / step + 1e-6)), 1)
    return np.asarray(0.5 * (low + high) + step * (np.arange(count) - 0.5 * (count - 1)))
