"""How deep interrogation windows must be for one plenoptic camera, and how fine voxels, so that depth is right."""

from __future__ import annotations

from math import ceil

from plenopiv.cameras.plenoptic import PlenopticCamera

MIN_WINDOW_DEPTH = 3.0  # half dead zones: at 2.3 displacements came out 40 % too small, at 4 right
WINDOW_STEP = 8  # voxels: windows are given in multiples of it
COARSEST = 0.25  # microlens pitches: of .22 depth is right, of .39 and .5 wrong by .5 to 2 voxels 7 mm off the axis


def coarsest_voxel_mm(camera: PlenopticCamera) -> float:
    """Largest side of a voxel in the plane, in mm: a quarter of what a microlens covers there.

    Particles in coarser voxels lie in whole columns of them, and displacements in the plane lock to whole voxels. Along
    a slanted line of sight depth takes up what they lack (decision 86).
    """
    return COARSEST * camera.lattice.pitch_mm / abs(camera.main_lens.magnification)


def min_window_depth_mm(camera: PlenopticCamera) -> float:
    """Least depth of a window, in mm: three times half the dead zone.

    Near focus a particle's reconstructed image is about as long as the dead zone. A shallower window holds only part of
    such an image, and displacements along z come out too small.
    """
    near, far = camera.dead_zone_mm()
    return MIN_WINDOW_DEPTH * (far - near) / 2


def min_window_voxels(camera: PlenopticCamera, voxel_mm: float) -> int:
    """``min_window_depth_mm`` in voxels of ``voxel_mm`` along z, rounded up to a multiple of 8."""
    return WINDOW_STEP * ceil(min_window_depth_mm(camera) / voxel_mm / WINDOW_STEP)
