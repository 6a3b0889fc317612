"""Particles and links of a tracked pair against the true ones, in bands of depth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray
from matching import matched
from numpy.typing import NDArray

from plenopiv.tracking.light import PointLights

Array = NDArray[np.float64]


def judged(
    tracks: xarray.Dataset,
    truth: tuple[Array, Array],
    of_points: PointLights,
    voxel_mm: Array,
    bands_mm: Mapping[str, tuple[float, float]],
) -> dict[str, dict]:
    """Found, ghosts, RMS of places in voxels and links, by band of |z|. ``truth``: the true positions (n, 3) mm of the
    same particles in both frames, of which those count whose light falls wholly on the sensor."""
    out: dict[str, dict] = {}
    frames = [tracks.isel(obs=np.flatnonzero(tracks.frame.values == number)) for number in (0, 1)]
    place = [np.stack([each[name].values for name in "xyz"], -1) for each in frames]
    partner = [matched(true, found, voxel_mm) for true, found in zip(truth, place, strict=True)]
    whole = [of_points(true).whole() > 0.999 for true in truth]
    track = [each.track_id.values for each in frames]
    for band, (low, high) in bands_mm.items():
        deep = np.abs(truth[0][:, 2])
        counted = whole[0] & (deep >= low) & (deep < high)
        reported = (np.abs(place[0][:, 2]) >= low) & (np.abs(place[0][:, 2]) < high)
        ghost = np.ones(len(place[0]), bool)
        ghost[partner[0][partner[0] >= 0]] = False
        one = counted & (partner[0] >= 0)
        off = (place[0][partner[0][one]] - truth[0][one]) / voxel_mm
        both = one & whole[1] & (partner[1] >= 0)
        a, b = track[0][partner[0][both]], track[1][partner[1][both]]
        right, other = (a == b) & (a >= 0), (a != b) & np.isin(a, track[1]) & (a >= 0)
        out[band] = {
            "n": int(counted.sum()),
            "found": round(float(one.sum() / counted.sum()), 4),
            "ghosts": round(float((ghost & reported).sum() / max(reported.sum(), 1)), 4),
            "rms": np.sqrt((off**2).mean(0)).round(4).tolist(),
            "both_found": int(both.sum()),
            "linked": round(float(right.mean()), 4),
            "wrong": round(float(other.sum() / max((right | other).sum(), 1)), 4),
        }
    return out
