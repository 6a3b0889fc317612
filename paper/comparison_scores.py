"""Measured velocity of the jet against the DNS: by depth, in voxels, mm/s and per cent of the jet's velocity.

Three truths: the mean of the DNS displacement over the last window (*window mean*), the DNS displacement at the vector
(*point*), and what a perfect correlation of the window's own particles would find (*particles*,
``plenopiv.accuracy.true_displacements``). The first holds against a method that its windows are large only where it is
compared with the second; the last alone knows that a window holds but a few particles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from comparison_settings import DT_S, JET_M_S, TARGET_DEPTH_MM, Across
from lightfield_case import Frames, Measured
from numpy.typing import NDArray

from plenopiv.accuracy import TrueDisplacements, true_displacements
from plenopiv.accuracy.velocity import GROSS_VOXELS
from plenopiv.simulation.flows import Velocity, advect

Array = NDArray[np.float64]
BANDS_MM = ((0.0, 2.0), (2.0, 4.0), (4.0, 6.0), (6.0, 8.0), (8.0, 10.0))  # of |z|
SAMPLES = 5  # of a window along each axis
AT_A_TIME = 2000  # windows
SMOOTH = 0.02  # of the jet's displacement: flow of which a window leaves less than this unresolved
TRUTHS = ("window_mean", "point", "particles")


def places(measured: Measured) -> Array:
    """Vectors (nz, ny, nx, 3) in mm."""
    field = measured.field
    z, y, x = np.meshgrid(field.z.values, field.y.values, field.x.values, indexing="ij")
    return np.stack([x, y, z], -1)


def point_displacement(flow: Velocity, at_mm: Array, steps: int = 1) -> Array:
    """Displacement (n, 3) in mm during DT_S of what is at ``at_mm`` (n, 3) at mid-time."""
    return advect(flow, at_mm, 0.5 * DT_S, steps) - advect(flow, at_mm, -0.5 * DT_S, steps)


def inside_window(half_mm: Array, along: int = SAMPLES) -> Array:
    """Places (n, 3) in mm from a window's middle, evenly over it, ``along`` each axis."""
    steps = (2 * np.arange(along) + 1) / along - 1
    return np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3) * half_mm


def window_mean(flow: Velocity, at_mm: Array, half_mm: Array) -> tuple[Array, Array]:
    """Its mean over windows of half sides ``half_mm`` about ``at_mm`` (n, 3), from SAMPLES^3 points, and how far in mm
    (n,), RMS, displacements in the window lie from their linear fit: motion that it does not resolve."""
    offsets = inside_window(half_mm)
    mean, unresolved = np.empty_like(at_mm), np.empty(len(at_mm))
    for first in range(0, len(at_mm), AT_A_TIME):
        now = slice(first, first + AT_A_TIME)
        moved = point_displacement(flow, (at_mm[now, None] + offsets).reshape(-1, 3))
        moved = moved.reshape(-1, len(offsets), 3)
        mean[now] = moved.mean(1)
        slopes = np.einsum("sk,nsc->nkc", offsets, moved) / (offsets**2).sum(0)[:, None]  # sampled evenly about 0
        off = moved - mean[now, None] - np.einsum("sk,nkc->nsc", offsets, slopes)
        unresolved[now] = np.sqrt((off**2).sum(2).mean(1))
    return mean, unresolved


def judged(measured: Measured, limits_mm: Across | None) -> NDArray[np.bool_]:
    """Vectors (nz, ny, nx) whose whole window is seen by every view and lies within limits along x and y."""
    chosen = measured.seen.copy()
    for axis, limits in enumerate(limits_mm or ()):
        off, half = places(measured)[..., axis], measured.half_mm[axis]
        chosen &= (off - half >= limits[0] - 1e-9) & (off + half <= limits[1] + 1e-9)
    return chosen


def vorticity(velocity: Array, x_mm: Array, y_mm: Array, z_mm: Array) -> Array:
    """Vorticity (3, nz, ny, nx) in 1/s of ``velocity`` (3, nz, ny, nx) in m/s: central differences between vectors."""
    dz, dy, dx = (np.stack([np.gradient(c, axis_mm * 1e-3, axis=k) for c in velocity])
                  for k, axis_mm in enumerate((z_mm, y_mm, x_mm)))  # fmt: skip
    return np.stack([dy[2] - dz[1], dz[0] - dx[2], dx[1] - dy[0]])


def inner(chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Chosen vectors with six chosen neighbours: those that central differences of chosen ones are known at."""
    wide = np.pad(chosen, 1)
    for axis in range(3):
        for step in (-1, 1):
            wide = wide & np.roll(np.pad(chosen, 1), step, axis)
    return wide[1:-1, 1:-1, 1:-1]


def velocity(measured: Measured, suffix: str = "") -> Array:
    """(3, nz, ny, nx) in m/s."""
    return np.stack([measured.field[name + suffix].values for name in "uvw"])


@dataclass(frozen=True)
class Truth:
    """Of n vectors at ``at_mm`` (n, 3), displacements (n, 3) in mm; ``unresolved_mm`` (n,) as in ``window_mean``."""

    at_mm: Array
    window_mean: Array
    unresolved_mm: Array
    point: Array
    particles: TrueDisplacements

    @classmethod
    def of(cls, flow: Velocity, at_mm: Array, half_mm: Array, particles: Frames) -> Truth:
        """The three truths of windows of half sides ``half_mm`` (3,)."""
        mean, unresolved = window_mean(flow, at_mm, half_mm)
        a, b = (p.position_mm for p in particles)
        own = true_displacements(at_mm, a, b, half_mm)
        return cls(at_mm, mean, unresolved, point_displacement(flow, at_mm), own)


class Judge:
    """Scores fields measured of one flow, vectors within limits along x and y. What is true of the same windows and
    particles, as by other sub-windows, is found once: it takes minutes."""

    def __init__(self, flow: Velocity, limits_mm: Across | None = None):
        self.flow, self.limits_mm = flow, limits_mm
        self._known: tuple[tuple[Array, ...], Truth] | None = None

    def _truth(self, measured: Measured, chosen: NDArray[np.bool_]) -> Truth:
        asked = places(measured)[chosen], measured.half_mm, *(p.position_mm for p in measured.particles)
        if self._known is None or not all(map(np.array_equal, asked, self._known[0])):
            self._known = asked, Truth.of(self.flow, *asked[:2], measured.particles)
        return self._known[1]

    def score(self, measured: Measured) -> tuple[dict[str, Any], Array]:
        """All errors of one field for JSON, and the window mean of the flow (3, nz, ny, nx) in m/s, NaN where it is not
        judged."""
        chosen = judged(measured, self.limits_mm)
        assert chosen.any(), "no window is seen by every view"
        truth, voxel = self._truth(measured, chosen), np.array(measured.voxel_mm)
        smooth = truth.unresolved_mm < SMOOTH * JET_M_S * DT_S * 1e3
        displacements = truth.window_mean, truth.point, truth.particles.window
        found = np.moveaxis(velocity(measured), 0, -1)[chosen] * (1e3 * DT_S)
        std = np.moveaxis(velocity(measured, "_std"), 0, -1)[chosen] * (1e3 * DT_S)
        replaced, depth = measured.field.valid.values[chosen] == 0, np.abs(truth.at_mm[:, 2])
        told: dict[str, Any] = {
            "voxel_mm": measured.voxel_mm,
            "window_mm": (2 * measured.half_mm).tolist(),
            "particles": len(measured.particles[0].electrons),
            "particles_per_window": float(truth.particles.particles.mean()),
            "candidates": measured.candidates,
            "vectors": int(chosen.sum()),
            "of_vectors": int(chosen.size),
            "wall_s": measured.clock.wall_s,
            "processor_s": measured.clock.processor_s,
            "errors": {
                name: by_depth(found - true, std, replaced, depth, smooth, voxel)
                for name, true in zip(TRUTHS, displacements, strict=True)
            },
        }
        mean = np.full((*chosen.shape, 3), np.nan)
        mean[chosen] = truth.window_mean
        true = np.moveaxis(mean, -1, 0) / (1e3 * DT_S)
        told["vorticity"] = vorticity_error(measured, true, chosen)
        told["correlation_with_window_mean"] = [
            float(np.corrcoef(f, t)[0, 1]) for f, t in zip(found.T, truth.window_mean.T, strict=True)
        ]
        return told, true


def by_depth(
    error_mm: Array, std_mm: Array, replaced: NDArray, depth_mm: Array, smooth: NDArray, voxel_mm: Array
) -> dict[str, Any]:
    """Errors (n, 3) in mm within each band of |z|, up to the promised depth and beyond, and over all; up to that depth
    for windows in ``smooth`` (n,) flow and in the others, too."""
    known = np.isfinite(error_mm).all(1)
    limits = [*BANDS_MM, (0.0, TARGET_DEPTH_MM), (TARGET_DEPTH_MM, np.inf), (0.0, np.inf)]
    names = [f"{lo:g}-{hi:g} mm" for lo, hi in BANDS_MM] + ["within", "beyond", "all"]
    bands = {}
    for name, (lo, hi) in zip(names, limits, strict=True):
        here = known & (depth_mm >= lo) & (depth_mm < hi)
        if here.any():
            bands[name] = errors(error_mm[here], std_mm[here], replaced[here], voxel_mm)
    for name, of in (("within, smooth", smooth), ("within, not", ~smooth)):
        here = known & (depth_mm < TARGET_DEPTH_MM) & of
        if here.any():
            bands[name] = errors(error_mm[here], std_mm[here], replaced[here], voxel_mm)
    return bands


def without_gross(error_mm: Array, voxel_mm: Array) -> tuple[float, Array]:
    """The share of vectors more than GROSS_VOXELS off on an axis, and the errors (n, 3) of the others in voxels; one
    NaN where none is left."""
    in_voxels = error_mm / voxel_mm
    fine = (np.abs(in_voxels) <= GROSS_VOXELS).all(1)
    return float(1 - fine.mean()), in_voxels[fine] if fine.any() else np.full((1, 3), np.nan)


def errors(error_mm: Array, std_mm: Array, replaced: NDArray, voxel_mm: Array) -> dict[str, Any]:
    """One set of vectors. Gross ones, more than GROSS_VOXELS off on an axis, are left out in voxels as in
    docs/accuracy.md, but not in mm/s and per cent: their limit is not the same length for all cameras."""
    in_mm_s, (gross, left) = error_mm / DT_S, without_gross(error_mm, voxel_mm)
    rms = np.sqrt((in_mm_s**2).mean(0))
    return {
        "vectors": len(error_mm),
        "gross": gross,
        "replaced": float(replaced.mean()),
        "rms_voxel": np.sqrt((left**2).mean(0)).tolist(),
        "bias_voxel": left.mean(0).tolist(),
        "rms_mm_s": rms.tolist(),
        "bias_mm_s": in_mm_s.mean(0).tolist(),
        "rms_percent": (0.1 * rms / JET_M_S).tolist(),
        "stated_mm_s": np.sqrt(((std_mm / DT_S) ** 2).mean(0)).tolist(),
        "inside_1_std": (np.abs(error_mm) <= std_mm).mean(0).tolist(),
        "inside_2_std": (np.abs(error_mm) <= 2 * std_mm).mean(0).tolist(),
    }


def vorticity_error(measured: Measured, true: Array, chosen: NDArray[np.bool_]) -> dict[str, float | None]:
    """RMS over the three components of the vorticity's error against the window means between the same vectors, in 1/s;
    None where no vector has six judged neighbours."""
    axes = (measured.field.x.values, measured.field.y.values, measured.field.z.values)
    here = inner(chosen)
    if not here.any() or min(chosen.shape) < 3:
        return {"rms_1_s": None, "true_rms_1_s": None, "vectors": 0}
    expected, found = (vorticity(v, *axes)[:, here] for v in (true, velocity(measured)))
    return {
        "rms_1_s": float(np.sqrt(((found - expected) ** 2).mean())),
        "true_rms_1_s": float(np.sqrt((expected**2).mean())),
        "vectors": int(here.sum()),
    }
