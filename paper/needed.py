"""What it would take to find the jet's displacements to 0.12 voxel in the plane (section 4).

Errors against the mean of the DNS over the paper's window, 64 x 64 x 16 voxels, in the volume of the reduced
comparison, by three questions:

- tracks: what perfect tracks of the particles would tell of that mean, by density. The mean of those in the window; the
  value in its middle of a linear fit, which is what a perfect correlation sees; and the mean over it of the smoothest
  field through the nearest tracks (thin plate splines), also around it.
- windows: what sub-windows of the paper's windows find, of exact volumes and of LF-PIV.
- beyond: LF-PIV's errors far from focus, by density and by depth of the lit volume.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from comparison_scores import Judge, inside_window, window_mean
from comparison_settings import REDUCED, TARGET_DEPTH_MM, TINY, VOXEL_MM, LightFieldSetting, Window
from lightfield_case import exact_volumes, reconstruct_light_field, seeded
from numpy.typing import NDArray
from outputs import command_line, write_numbers
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from plenopiv.accuracy import true_displacements
from plenopiv.simulation.flows import Velocity, flow

Array = NDArray[np.float64]
NEAREST = 60  # tracks that a smooth field takes account of
SAMPLES = 4  # of a window along each axis
DENSITIES = 1.0, 2.0, 4.0, 8.0  # particles per microlens, of tracks
INNER: tuple[tuple[Window | None, float], ...] = (  # sub-windows of the paper's windows, and their overlap
    (None, 0.5),
    ((48, 48, 12), 0.5),
    ((48, 48, 12), 0.6),
    ((48, 48, 12), 0.75),
    ((40, 40, 10), 0.6),
    ((32, 32, 8), 0.5),
    ((32, 32, 8), 0.6),
)
BEYOND = (  # particles per microlens, z limits in mm
    (1.0, (-10.0, 10.0)),
    (0.5, (-10.0, 10.0)),
    (1.0, (4.0, 10.0)),
)


def half_window(setting: LightFieldSetting) -> Array:
    """Half the paper's window along x, y, z, mm."""
    return 0.5 * np.array(setting.windows[-1]) * VOXEL_MM


def centres(setting: LightFieldSetting) -> Array:
    """Middles (n, 3) in mm of windows, half a window apart, that lie where windows are judged."""
    across = setting.judged_mm or setting.volume_mm[:2]
    half, axes = half_window(setting), []
    for (low, high), margin in zip((*across, setting.volume_mm[2]), half, strict=True):
        axes.append(np.arange(low + margin, high - margin + 1e-9, margin))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def rms(error: Array) -> list[float]:
    """Along x, y, z."""
    return np.sqrt((error**2).mean(0)).tolist()


def mean_over_windows(field: Callable[[Array], Array], at: Array, half: Array) -> Array:
    """Means (n, 3) of ``field``, of places (m, 3) in mm, over windows about ``at``."""
    places = (at[:, None] + inside_window(half, SAMPLES)).reshape(-1, 3)
    return field(places).reshape(len(at), -1, 3).mean(1)


def tracks(setting: LightFieldSetting, jet: Velocity, density: float) -> dict[str, Any]:
    """Errors of means over windows up to the promised depth from true tracks of the particles of one pair."""
    half, at = half_window(setting), centres(setting)
    at = at[np.abs(at[:, 2]) + half[2] <= TARGET_DEPTH_MM + 1e-9]
    a, b = (p.position_mm for p in seeded(replace(setting, particles_per_microlens=density), jet, 0))
    middle, moved = 0.5 * (a + b), b - a
    mean, _ = window_mean(jet, at, half)
    fit = true_displacements(at, a, b, half)
    known, tree = np.isfinite(fit.window).all(1), cKDTree(middle / half)
    own = [tree.query_ball_point(place, 1.0, p=np.inf) for place in at / half]
    smooth = RBFInterpolator(middle, moved, neighbors=min(NEAREST, len(moved)))
    field = mean_over_windows(smooth, at, half)
    return {
        "particles_per_microlens": density,
        "particles_per_window": float(fit.particles.mean()),
        "mean": rms((np.array([moved[n].mean(0) for n in own]) - mean)[known] / VOXEL_MM),
        "linear_fit": rms((fit.window - mean)[known] / VOXEL_MM),
        "smooth_field": rms((field - mean) / VOXEL_MM),
    }


def inner_windows(setting: LightFieldSetting, jet: Velocity, inner=INNER) -> Iterator[dict[str, Any]]:
    """Of exact volumes and of LF-PIV, errors by sub-windows and their overlap."""
    judge = Judge(jet, setting.judged_mm)
    for name, reconstruct in (("exact", exact_volumes), ("light_field", reconstruct_light_field)):
        pair = reconstruct(setting, jet)
        for window, overlap in inner:
            measured = pair.correlated(window, overlap)
            told, _ = judge.score(measured)
            kept = ("vectors", "rms_voxel", "gross", "inside_1_std", "inside_2_std")
            yield {
                "volumes": name,
                "inner_window": window,
                "overlap": overlap,
                "correlation_s": measured.clock.processor_s["correlation"],
                "bands": {band: {key: e[key] for key in kept} for band, e in told["errors"]["window_mean"].items()},
            }


def beyond(
    setting: LightFieldSetting, jet: Velocity, density: float, z_mm: tuple[float, float]
) -> Iterator[dict[str, Any]]:
    """LF-PIV's errors by depth, and by smooth flow, with another density or depth of the lit volume, in the paper's
    windows and with others in them."""
    now = replace(setting, particles_per_microlens=density, volume_mm=(*setting.volume_mm[:2], z_mm))
    pair, judge = reconstruct_light_field(now, jet), Judge(jet, now.judged_mm)
    for window in (None, now.inner_window):
        told, _ = judge.score(pair.correlated(window))
        bands = told["errors"]["window_mean"]
        yield {
            "particles_per_microlens": density,
            "z_mm": z_mm,
            "inner_window": window,
            "candidates": told["candidates"],
            "bands": {band: {key: e[key] for key in ("vectors", "rms_voxel", "gross")} for band, e in bands.items()},
        }


def main(out: Path, reduced: bool) -> None:
    """Measure all, and write paper/results/needed.json."""
    setting = TINY if reduced else REDUCED
    jet, light_field = flow("jet", at_mm=setting.jet_at_mm), setting.light_field
    own = light_field.particles_per_microlens
    found: dict[str, Any] = {"tracks": [], "windows": [], "beyond": []}
    for density in (own,) if reduced else DENSITIES:
        found["tracks"].append(tracks(light_field, jet, density))
        print(found["tracks"][-1], flush=True)
    inner = INNER[:1] if reduced else INNER
    for line in inner_windows(light_field, jet, inner):
        found["windows"].append(line)
        print(line, flush=True)
    for density, z_mm in ((own, light_field.volume_mm[2]),) if reduced else BEYOND:
        for line in beyond(light_field, jet, density, z_mm):
            found["beyond"].append(line)
            print(line, flush=True)
    write_numbers(out, "needed", found)


if __name__ == "__main__":
    command_line(main, __doc__)
