"""Depth, voxels and windows suggested for a camera."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10

from plenopiv.cameras.coverage import half_sensor_mm, seen_by_every_view_mm
from plenopiv.cameras.depth import WINDOW_STEP, min_window_voxels
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits, VoxelGrid

VOXEL_PX = 36.0 / 2100.0 / 0.0055  # Shi, Ding & New (2016), section 4: 36 mm / 2100 voxels, pixels of 5.5 um
VOXEL_PITCHES = VOXEL_PX / 14  # the same in microlens pitches, of the paper's camera of PMR 14 (decision 86)
USEFUL_DEPTH = 0.75  # of PMR f_l / M^2, where a view's footprint of a point outgrows a microlens
LARGEST_BLUR = 0.25  # of the sensor's half height
SMALLEST_WINDOW = 8  # voxels
LAST_WINDOW = (64, 64, 16)  # of the paper's voxels

Window = tuple[int, int, int]


@dataclass(frozen=True)
class Measurement:
    """What is reconstructed and correlated: outer faces in mm, voxel in mm along x, y, z, windows in voxels."""

    limits_mm: Limits
    voxel_mm: tuple[float, float, float]
    windows: tuple[Window, ...]

    @property
    def grid(self) -> VoxelGrid:
        """The voxels."""
        return VoxelGrid.covering(*self.limits_mm, self.voxel_mm)

    @property
    def window_mm(self) -> tuple[float, float, float]:
        """The last window along x, y, z."""
        x, y, z = (n * d for n, d in zip(self.windows[-1], self.voxel_mm, strict=True))
        return x, y, z


def suggested(camera: PlenopticCamera, depth_mm: tuple[float, float] | None = None) -> Measurement:
    """The volume that every view sees over a depth, default ``suggested_depth_mm``, in voxels as
    ``suggested_voxel_mm``, and the paper's windows, as large in mm.

    Raises:
        PlenoPIVError: the depth is empty, holds no window or reaches the main lens, or no window would be seen by every
            view.
    """
    lo, hi = depth_mm or suggested_depth_mm(camera)
    lens_z = camera.main_lens.object_distance_mm
    if not lo < hi < lens_z:
        raise PlenoPIVError(
            f"[{lo:g}, {hi:g}] mm must rise and end before the main lens, which is at z = {lens_z:.6g} mm"
        )
    x, y = (float(min(side)) for side in seen_by_every_view_mm(camera, [lo, hi]))
    voxel = suggested_voxel_mm(camera)
    if min(x, y) < SMALLEST_WINDOW * voxel[0]:
        seen = f"every view sees |x| < {max(x, 0):.2g}, |y| < {max(y, 0):.2g} mm from z = {lo:g} to {hi:g} mm"
        raise PlenoPIVError(f"[{lo:g}, {hi:g}] mm is too deep: {seen}")
    x, y = _down(x), _down(y)
    limits = (-x, x), (-y, y), (float(lo), float(hi))
    nz, ny, nx = VoxelGrid.covering(*limits, voxel).shape
    if nz < SMALLEST_WINDOW:
        raise PlenoPIVError(
            f"[{lo:g}, {hi:g}] mm is too thin: windows are {SMALLEST_WINDOW} voxels deep or more, which this camera "
            f"makes {SMALLEST_WINDOW * voxel[2]:.3g} mm, and it holds {nz}"
        )
    across = WINDOW_STEP * ceil(LAST_WINDOW[0] * _paper_voxel_mm(camera) / voxel[0] / WINDOW_STEP - 1e-6)
    last = across, across, max(LAST_WINDOW[2], min_window_voxels(camera, voxel[2]))
    first = 2 * last[0], 2 * last[1], 2 * last[2]
    return Measurement(limits, voxel, (within(first, (nx, ny, nz)), within(last, (nx, ny, nz))))


def within(window: Window, volume: Window) -> Window:
    """A window no larger than ``volume``, voxels along x, y, z."""
    x, y, z = map(min, window, volume)
    return x, y, z


def suggested_depth_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Where one plenoptic camera resolves depth well, and all its views still see most of the field.

    Within 0.75 PMR f_l/M^2 of the focal plane, and where the blur's radius |A| P_m/2 takes at most a quarter of the
    sensor's half height W: with A = S_i z / (S_o (S_o - z)), z = k S_o/(1 + k), k = (W/4) (2/P_m) (S_o/S_i).
    """
    lens = camera.main_lens
    resolved = USEFUL_DEPTH * camera.pixels_per_microlens * camera.microlens_focal_length_mm / lens.magnification**2
    k = LARGEST_BLUR * min(half_sensor_mm(camera)) * 2 / lens.aperture_mm / abs(lens.magnification)
    reach = _down(min(resolved, k * lens.object_distance_mm / (1 + k)))
    return -reach, reach


def suggested_voxel_mm(camera: PlenopticCamera) -> tuple[float, float, float]:
    """The paper's voxels: 3.117 pixels over |M| in the plane, one microlens pitch over M^2 in depth. With fewer than 14
    pixels to a microlens finer ones in the plane, 0.2226 pitches over |M| (decision 86)."""
    m = abs(camera.main_lens.magnification)
    in_plane = min(_paper_voxel_mm(camera), round(VOXEL_PITCHES * camera.lattice.pitch_mm / m, 10))
    return in_plane, in_plane, round(camera.lattice.pitch_mm / m**2, 10)


def _paper_voxel_mm(camera: PlenopticCamera) -> float:
    """The paper's, in the plane."""
    return round(VOXEL_PX * camera.sensor.pixel_pitch_mm / abs(camera.main_lens.magnification), 10)


def _down(length: float) -> float:
    """Rounded down to two digits, so that a limit stays inside what it was computed from."""
    step = 10.0 ** (floor(log10(length)) - 1)
    return round(floor(length / step + 1e-9) * step, 12)
