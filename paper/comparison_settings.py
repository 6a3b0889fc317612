"""What is compared in section 4 of the paper and beyond, in three sizes: lit volumes, cameras, densities, windows.

Of the paper: 36 x 24 x 20 mm, one particle per microlens in 2100 x 1400 x 260 voxels for LF-PIV; four cameras at
0.074 mm/px and 0.05 particles per pixel for Tomo-PIV; dt = 0.5 ms. Angles and distance of the four cameras are ours,
the paper states none. Smaller sizes are cut across, where the jet's shear layer is.
"""

from __future__ import annotations

from dataclasses import dataclass

from plenopiv.simulation.particles import Limits
from plenopiv.volume import VoxelGrid

Vector = tuple[float, float, float]
Window = tuple[int, int, int]
Across = tuple[tuple[float, float], tuple[float, float]]

DT_S = 0.0005
JET_M_S = 2500 * 1e-3 / 6.0  # Re nu / D in water, docs/jet.md
VOXEL_MM = (36 / 2100, 24 / 1400, 20 / 260)
DEPTH_MM = (-10.0, 10.0)
TARGET_DEPTH_MM = 6.0  # of |z|, up to which errors are promised


@dataclass(frozen=True)
class LightFieldSetting:
    """One plenoptic camera. ``volume_mm``: lit, seeded and reconstructed. ``judged_mm``: limits along x and y within
    which windows are judged; None, wherever every view sees them. ``rays``: simulated, of each particle.
    ``inner_window``: volumes are correlated once more with these within the last of ``windows``."""

    volume_mm: Limits
    judged_mm: Across | None = None
    windows: tuple[Window, ...] = ((128, 128, 32), (64, 64, 16))
    overlap: float = 0.5
    inner_window: Window = (40, 40, 10)
    camera: str = "29mp"
    particles_per_microlens: float = 1.0
    rays: int = 4000

    @property
    def grid(self) -> VoxelGrid:
        """The voxels, the paper's at any size."""
        return VoxelGrid.covering(*self.volume_mm, VOXEL_MM)


@dataclass(frozen=True)
class TomoSetting:
    """Four pinhole cameras at the corners of a square, turned by +-``angle_deg`` about y and about x.

    ``volume_mm``: lit, seeded and reconstructed in cubic voxels of ``scale_mm_px``, which is a pixel at the middle.
    ``judged_mm``, ``inner_window``: as of a light field.
    ``particles_per_pixel``: over the volume's x-y face; None takes the particles of the light field. ``sensor_px``: the
    most columns and rows; what the volume leaves dark is not simulated. ``diameter_px``: of particle images, e^-2.
    """

    volume_mm: Limits
    judged_mm: Across | None = None
    windows: tuple[Window, ...] = ((64, 64, 64), (32, 32, 32))
    overlap: float = 0.75
    inner_window: Window | None = None
    scale_mm_px: float = 0.074
    particles_per_pixel: float | None = 0.05
    angle_deg: float = 20.0
    distance_mm: float = 600.0
    sensor_px: int = 2048
    diameter_px: float = 2.7

    @property
    def grid(self) -> VoxelGrid:
        """The voxels."""
        return VoxelGrid.covering(*self.volume_mm, (self.scale_mm_px,) * 3)


@dataclass(frozen=True)
class TwoCamerasSetting:
    """Two plenoptic cameras of a kind, one in front (+z), one at the side (+x). Voxels are cubes of ``voxel_mm``, as
    each camera's depth lies across the other; the rest as in ``LightFieldSetting``."""

    volume_mm: Limits
    judged_mm: Across | None = None
    windows: tuple[Window, ...] = ((64, 64, 72), (32, 32, 36))
    overlap: float = 0.5
    inner_window: Window | None = None
    camera: str = "29mp"
    voxel_mm: float = 2 * VOXEL_MM[0]
    rays: int = 4000

    @property
    def grid(self) -> VoxelGrid:
        """The voxels."""
        return VoxelGrid.covering(*self.volume_mm, (self.voxel_mm,) * 3)


@dataclass(frozen=True)
class Comparison:
    """Four measurements of one jet: LF-PIV and Tomo-PIV as the paper has them; of the light field's particles, with
    windows of the same size in mm, LF-PIV with two cameras (``two``) and Tomo-PIV (``matched``).

    ``jet_at_mm``: the point of the jet that lies at the origin.
    """

    name: str
    light_field: LightFieldSetting
    two: TwoCamerasSetting
    tomo: TomoSetting
    matched: TomoSetting
    jet_at_mm: Vector = (0.0, 0.0, 0.0)


MATCHED_SCALE_MM_PX = 36 / 2048


def second_camera(light_field: LightFieldSetting) -> TwoCamerasSetting:
    """The same volume, particles and windows (to an even number of voxels) with a second camera at the side."""
    windows, inner = _windows_of(light_field, TwoCamerasSetting.voxel_mm)
    return TwoCamerasSetting(
        light_field.volume_mm, light_field.judged_mm, windows, inner_window=inner, rays=light_field.rays
    )


def _windows_of(light_field: LightFieldSetting, voxel_mm: float) -> tuple[tuple[Window, ...], Window]:
    """A light field's windows and its inner one in cubic voxels, to an even number of them."""
    *windows, inner = (
        tuple(2 * round(0.5 * n * side / voxel_mm) for n, side in zip(window, VOXEL_MM, strict=True))
        for window in (*light_field.windows, light_field.inner_window)
    )
    return tuple(windows), inner  # type: ignore[return-value]


def matched(light_field: LightFieldSetting) -> TomoSetting:
    """Tomo-PIV of the particles of a light field: the whole width on 2048 px, windows of the same size to an even
    number of voxels."""
    windows, inner = _windows_of(light_field, MATCHED_SCALE_MM_PX)
    return TomoSetting(
        light_field.volume_mm,
        light_field.judged_mm,
        windows,
        light_field.overlap,
        inner,
        MATCHED_SCALE_MM_PX,
        particles_per_pixel=None,
    )


def _about_axis(width: float, height: float, depth: tuple[float, float] = DEPTH_MM) -> Limits:
    return (-0.5 * width, 0.5 * width), (-0.5 * height, 0.5 * height), depth


# Two cameras see a volume as deep for the second as for the first: what is 36 mm wide would be 36 mm deep for it.
FULL_LIGHT_FIELD = LightFieldSetting(_about_axis(36.0, 24.0))
FULL = Comparison(
    "full",
    FULL_LIGHT_FIELD,
    second_camera(LightFieldSetting(_about_axis(20.0, 24.0))),
    TomoSetting(_about_axis(36.0, 24.0)),
    matched(FULL_LIGHT_FIELD),
)

# From the jet's axis across its shear layer. The paper's Tomo-PIV has a wider lit volume, as lines of sight at 20
# degrees leave a narrow one, and is judged over more of x, along which the jet's statistics do not change: its windows
# are ten times as large. The matched one has the light field's volume with its particles.
JUDGED_Y_MM = (-2.25, 2.25)
CUT_LIGHT_FIELD = LightFieldSetting(_about_axis(7.5, 6.0), ((-3.0, 3.0), JUDGED_Y_MM))
REDUCED = Comparison(
    "reduced",
    CUT_LIGHT_FIELD,
    second_camera(CUT_LIGHT_FIELD),
    TomoSetting(_about_axis(34.0, 13.0), ((-15.0, 15.0), JUDGED_Y_MM)),
    matched(CUT_LIGHT_FIELD),
    jet_at_mm=(0.0, 2.0, 0.0),
)

# Seconds, for tests: one layer of windows in front of focus, Tomo-PIV in smaller windows.
TINY_LIGHT_FIELD = LightFieldSetting(
    _about_axis(2.8, 3.3, (0.5, 3.0)), particles_per_microlens=0.3, windows=((96, 96, 24), (64, 64, 16)), rays=1000
)
SMALL_WINDOWS = ((32, 32, 32), (24, 24, 24))
TINY = Comparison(
    "tiny",
    TINY_LIGHT_FIELD,
    second_camera(TINY_LIGHT_FIELD),
    TomoSetting(_about_axis(4.8, 4.8, (-2.4, 2.4)), windows=SMALL_WINDOWS, overlap=0.5),
    TomoSetting(
        TINY_LIGHT_FIELD.volume_mm,
        windows=SMALL_WINDOWS,
        overlap=0.5,
        inner_window=(16, 16, 16),
        scale_mm_px=0.05,
        particles_per_pixel=None,
    ),
    jet_at_mm=(0.0, 3.0, 0.0),
)
SIZES = {size.name: size for size in (FULL, REDUCED, TINY)}
