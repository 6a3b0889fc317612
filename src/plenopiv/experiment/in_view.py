"""What a camera sees of [volume], and how well."""

from __future__ import annotations

from plenopiv.cameras.coverage import coverage, seen_by_every_view_mm
from plenopiv.cameras.depth import coarsest_voxel_mm, min_window_depth_mm, min_window_voxels
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.experiment.tables import CorrelationTable, VolumeTable
from plenopiv.volume import Limits

SLANTED = 0.025  # slope of a line of sight from which on voxels must be fine beside a microlens


def behind_lens(volume: VolumeTable, camera: PlenopticCamera, space: SpaceMap | None = None) -> list[str]:
    """A line where the volume is not in front of the main lens. ``space``: the volume is the laboratory's."""
    nearest, lens_z = _depth(volume, space)[1], camera.main_lens.object_distance_mm
    if nearest < lens_z:
        return []
    there = "" if space is None else "in lens space "
    return [f"volume.z_mm: {nearest:g} mm {there}is not in front of the main lens, which is at z = {lens_z:.6g} mm"]


def unseen(volume: VolumeTable, camera: PlenopticCamera, space: SpaceMap | None = None) -> list[str]:
    """A line where no view sees some part of the volume that is not said to be empty."""
    share = coverage(camera, _limits(volume), space=space).no_view
    if share == 0 or volume.unseen == "empty":
        return []
    way_out = f'{_seen_limits(volume, camera, space)}; or leave it empty: volume.unseen = "empty"'
    return [f"volume: {_percent(share)} % of it is seen by no view; {way_out}"]


def warnings(
    volume: VolumeTable, correlation: CorrelationTable, camera: PlenopticCamera, space: SpaceMap | None = None
) -> list[str]:
    """Where depth cannot be told or is seen worse, one line each; ``space`` as above."""
    depth, lines = _depth(volume, space), list[str]()
    near, far = camera.dead_zone_mm()
    if near <= depth[0] and depth[1] <= far:
        lines.append(
            f"the whole volume lies where depth cannot be told (z from {near:.3g} to {far:.3g} mm, where a point's "
            f"blur is smaller than a microlens); widen volume.z_mm or move the focal plane"
        )
    deeper = (
        1.0 if space is None else (volume.z_mm[1] - volume.z_mm[0]) / (depth[1] - depth[0])
    )  # than the lens sees it
    window, voxel = correlation.windows[-1][2], volume.voxel_mm[2]
    if window * voxel < min_window_depth_mm(camera) * deeper:
        enough = min_window_voxels(camera, voxel / deeper)
        lines.append(
            f"correlation.windows: the last ones are {window * voxel:.2g} mm deep and particles' images hardly "
            f"less (the dead zone is {(far - near) * deeper:.2g} mm), so displacements in depth come out too small; "
            f"give windows {enough} voxels along z"
        )
    side, coarsest = max(volume.voxel_mm[:2]), coarsest_voxel_mm(camera)
    if side > coarsest * (1 + 1e-6) and _steepest(volume, camera, space) > SLANTED:
        lines.append(
            f"volume.voxel_mm: {side:.3g} mm along x or y is coarse beside what a microlens covers "
            f"({camera.lattice.pitch_mm / abs(camera.main_lens.magnification):.3g} mm): displacements lock to whole "
            "voxels, and off the axis those in depth may be wrong by more than their error bars; give "
            f"{coarsest:.2g} mm or less"
        )
    seen = coverage(camera, _limits(volume), space=space).every_view
    if seen < 1:
        lines.append(
            f"{_percent(1 - seen)} % of the volume is missed by some views, and depth is worse there; "
            f"{_seen_limits(volume, camera, space)}"
        )
    return lines


def _steepest(volume: VolumeTable, camera: PlenopticCamera, space: SpaceMap | None) -> float:
    """Largest slope against the optical axis of the line of sight to a place of the volume, along x or y."""
    sides = _limits(volume) if space is None else space.lens_limits(_limits(volume))
    aside = max(abs(limit) for side in sides[:2] for limit in side)
    return aside / (camera.main_lens.object_distance_mm - sum(sides[2]) / 2)


def _percent(share: float) -> str:
    return "100" if share > 0.995 else f"{100 * share:.2g}"


def _limits(volume: VolumeTable) -> Limits:
    return volume.x_mm, volume.y_mm, volume.z_mm


def _depth(volume: VolumeTable, space: SpaceMap | None) -> tuple[float, float]:
    """The volume's depth as the lens has it."""
    return volume.z_mm if space is None else space.lens_limits(_limits(volume))[2]


def _seen_limits(volume: VolumeTable, camera: PlenopticCamera, space: SpaceMap | None) -> str:
    if space is not None:
        return "reduce x_mm, y_mm or z_mm, or move it to the middle of what the camera sees"
    x, y = (float(min(side)) for side in seen_by_every_view_mm(camera, volume.z_mm))
    lo, hi = volume.z_mm
    if min(x, y) <= 0:
        return f"at z = {lo:g} or {hi:g} mm no point is seen by every view: reduce z_mm"
    return f"every view sees |x| < {x:.3g} mm, |y| < {y:.3g} mm from z = {lo:g} to {hi:g} mm"
