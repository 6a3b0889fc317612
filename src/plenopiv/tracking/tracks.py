"""Particles of all frames and their links as one dataset: tracks.nc."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import Links
from plenopiv.tracking.trajectories import Trajectories

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
NAMES = ("x", "y", "z", "u", "v", "w")


def tracks_dataset(
    frames: Sequence[tuple[int, FrameParticles]], links: Sequence[tuple[int, int, Links]], dt_s: float
) -> xarray.Dataset:
    """All particles as an xarray Dataset with dimension ``obs``, one entry for each particle of each frame.

    ``frames``: numbers from 0 and particles; ``links``: numbers of two frames ``dt_s`` apart and the links between
    them. x, y, z in mm; u, v, w in m/s from the link to the next frame, or else from the one before, NaN without;
    x_std ... w_std; covariance (obs, 6, 6) of x, y, z (mm) and u, v, w (m/s); light in counts, light_std; frame;
    track_id, the same wherever a particle is seen, -1 without a link.
    """
    first = dict(zip([number for number, _ in frames], _starts([len(p.light) for _, p in frames]), strict=True))
    total = sum(len(p.light) for _, p in frames)
    position = np.concatenate([p.position_mm for _, p in frames]).reshape(-1, 3)
    own = np.concatenate([p.covariance for _, p in frames]).reshape(-1, 4, 4)
    covariance = np.full((total, 6, 6), np.nan)
    covariance[:, :3, :3] = own[:, :3, :3]
    velocity, track = np.full((total, 3), np.nan), np.full(total, -1, np.int64)
    rate = 1e-3 / dt_s  # mm per frame -> m/s
    following = 0
    for a_frame, b_frame, each in links:
        a, b = first[a_frame] + each.a, first[b_frame] + each.b
        fresh = track[a] < 0
        track[a[fresh]] = following + np.arange(fresh.sum())
        following += int(fresh.sum())
        track[b] = track[a]
        moved = (position[b] - position[a]) * rate
        of_a, of_b = own[a][:, :3, :3], own[b][:, :3, :3]
        for at, cross in ((a, -of_a * rate), (b, of_b * rate)):
            velocity[at] = moved
            covariance[at, 3:, 3:] = (of_a + of_b) * rate**2
            covariance[at, :3, 3:] = cross
            covariance[at, 3:, :3] = np.swapaxes(cross, 1, 2)
    frame = np.repeat([number for number, _ in frames], [len(p.light) for _, p in frames])
    return _observations(frames, np.concatenate([position, velocity], 1), covariance, frame, track)


def smooth_dataset(frames: Sequence[tuple[int, FrameParticles]], smooth: Trajectories, dt_s: float) -> xarray.Dataset:
    """All particles on their smooth tracks, as ``tracks_dataset``: positions are the smooth ones, u, v, w and all
    covariances those of the smoothing; ax, ay, az in m/s^2 with ax_std, ay_std, az_std besides. ``frames``: numbers
    from 0 and particles, ``dt_s`` apart, in the order of ``smooth``."""
    rate = 1e-3 / dt_s
    unit = np.concatenate([np.ones(3), np.full(3, rate), np.full(3, rate / dt_s)])  # of mm and frames
    covariance = smooth.covariance * unit[:, None] * unit
    values, std = smooth.mean * unit, np.sqrt(np.einsum("nii->ni", covariance))
    out = _observations(frames, values[:, :6], covariance[:, :6, :6], smooth.frame, smooth.track)
    for k, axis in enumerate("xyz"):
        name, units = f"a{axis}", {"units": "m s-2"}
        said = {"long_name": f"acceleration along {axis}", "ancillary_variables": f"{name}_std"}
        out[name] = ("obs", values[:, 6 + k], units | said)
        out[f"{name}_std"] = ("obs", std[:, 6 + k], units | {"long_name": f"standard deviation of {name}"})
    return out


def _observations(
    frames: Sequence[tuple[int, FrameParticles]], values: Array, covariance: Array, frame: NDArray, track: NDArray
) -> xarray.Dataset:
    """Entries of positions and velocities (obs, 6) with their covariance (obs, 6, 6)."""
    import xarray as xr

    light_std = [np.sqrt(p.covariance[:, 3, 3]) for _, p in frames]
    std = np.sqrt(np.einsum("nii->ni", covariance))
    variables: dict[str, tuple] = {}
    for k, name in enumerate(NAMES):
        units, what = ("mm", f"position along {name}") if k < 3 else ("m s-1", f"velocity along {'xyz'[k - 3]}")
        variables[name] = (
            "obs",
            values[:, k],
            {"units": units, "long_name": what, "ancillary_variables": f"{name}_std"},
        )
        variables[f"{name}_std"] = ("obs", std[:, k], {"units": units, "long_name": f"standard deviation of {name}"})
    variables |= {
        "covariance": (
            ("obs", "parameter", "parameter_2"),
            covariance,
            {"long_name": "covariance of x, y, z (mm) and u, v, w (m/s)"},
        ),
        "light": (
            "obs",
            np.concatenate([p.light for _, p in frames]),
            {"units": "count", "long_name": "light of the particle in all pixels"},
        ),
        "light_std": (
            "obs",
            np.concatenate(light_std),
            {"units": "count", "long_name": "standard deviation of light"},
        ),
        "misfit": ("obs", np.concatenate([p.misfit for _, p in frames]), {"long_name": "chi^2 of its pixels, each"}),
        "frame": ("obs", frame.astype(np.int32), {"long_name": "number of the frame, from 0"}),
        "track_id": (
            "obs",
            track,
            {"long_name": "the same number wherever a particle is seen, -1 without a link"},
        ),
    }
    return xr.Dataset(variables, coords={"parameter": list(NAMES), "parameter_2": list(NAMES)})


def _starts(counts: Sequence[int]) -> list[int]:
    return [0, *np.cumsum(counts).tolist()][:-1]


def joined(pairs: Sequence[xarray.Dataset]) -> xarray.Dataset:
    """The tracks of several pairs (``tracks_dataset``), in the order of time, as one dataset: a frame that two pairs
    share is there once, and a particle that both link has one ``track_id``."""
    import xarray as xr

    frames: dict[int, xarray.Dataset] = {}
    for pair in pairs:
        for number in np.unique(pair["frame"].values).tolist():
            if number not in frames:
                frames[number] = pair.isel(obs=np.flatnonzero(pair["frame"].values == number))
    numbers = sorted(frames)
    whole = xr.concat([frames[k] for k in numbers] or pairs[:1], "obs", data_vars="minimal", coords="minimal")
    starts = dict(zip(numbers, _starts([frames[k].sizes["obs"] for k in numbers]), strict=True))
    track = np.full(whole.sizes["obs"], -1, np.int64)
    moving = {name: whole[name].values.copy() for name in (*NAMES[3:], *(f"{n}_std" for n in NAMES[3:]), "covariance")}
    following = 0
    for pair in pairs:
        of, number = pair["track_id"].values, pair["frame"].values
        at = np.empty(len(of), np.int64)  # where its entries are in the whole
        for frame in np.unique(number).tolist():
            in_frame = np.flatnonzero(number == frame)
            at[in_frame] = starts[frame] + np.arange(len(in_frame))
        linked = np.flatnonzero(of >= 0)  # an end beside the volume is not there: ids alone say which belong together
        ids, which = np.unique(of[linked], return_inverse=True)
        known = np.full(len(ids), -1, np.int64)
        np.maximum.at(known, which, track[at[linked]])
        fresh = known < 0
        known[fresh] = following + np.arange(fresh.sum())
        following += int(fresh.sum())
        track[at[linked]] = known[which]
        first = linked[number[linked] == number.min(initial=np.iinfo(number.dtype).max)]
        for name, values in moving.items():  # to the next frame, where there is a link
            values[at[first]] = pair[name].values[first]
    variables: dict[str, tuple] = {"track_id": ("obs", track, whole["track_id"].attrs)}
    variables |= {name: (whole[name].dims, values, whole[name].attrs) for name, values in moving.items()}
    return whole.assign(variables)
