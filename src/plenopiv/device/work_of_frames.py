"""What the reconstruction of a frame of a plenoptic camera moves and computes on a device: ``work`` of its stages.

``images``: a plane spread into its map and read off it, for each group of views; ``back``: corrections written into
the map and summed from it; ``candidates``: dense ray tracing. Buckets of planes tell how large maps are, and how many
products and microlenses a point takes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil

from plenopiv.device.plane_tables import Bucket
from plenopiv.device.work import FLOAT, Work

PLACE = 40.0  # operations of a pixel: where it lies on a map, its lit share, what is read there
READ = 14.0  # floats: the pixel's lens, its place, four points of the map
ABOUT = 25.0  # operations of a microlens that may light a point of a map
WRITTEN = 2.0  # floats of a point of a map and a view: its sum; the microlenses about it come from a cache
JUDGED = 90.0  # operations of a voxel and a pixel that may rule it out: its place, an area
SWEPT = 3.0  # floats of a voxel and a judging view
LEFT = 0.3  # share of the voxels that an average view has left to judge, where they are densely seeded


def reconstruction(
    plane: tuple[int, int],
    buckets: Sequence[Bucket],
    pixels: int,
    groups: Sequence[int],
    judged: Sequence[tuple[int, int]],
    judging: int,
) -> Mapping[str, Work]:
    """By stage, of one frame on planes of (ny, nx) voxels. ``pixels``: of a view; ``groups``: of how many views each
    correction of the volume is, all iterations; ``judged``: numbers of planes, and how many microlenses of a view may
    rule out a voxel of them; ``judging``: how many views do."""
    images, back = Work(), Work()
    used, times = sum(groups), len(groups)
    for bucket in buckets:
        spread = map_work(bucket, plane)
        points = map_points(bucket, plane)
        read = Work(FLOAT * READ * pixels, PLACE * pixels)
        lenses = bucket.window[0] * bucket.window[1]
        written = Work(FLOAT * (WRITTEN * points + READ * pixels), ABOUT * lenses * points + PLACE * pixels)
        voxels = Work(FLOAT * 2 * plane[0] * plane[1], 10.0 * plane[0] * plane[1])
        images += (spread.times(times * bucket.members) + read.times(used)).times(bucket.planes)
        back += ((spread + voxels).times(times * bucket.members) + written.times(used)).times(bucket.planes)
    area, candidates = float(plane[0] * plane[1]), Work()
    for planes, lenses in judged:
        candidates += Work(FLOAT * SWEPT * area, JUDGED * lenses * area).times(LEFT * planes * judging)
    calls = Work(calls=times)
    return {"images": images + calls, "back": back, "candidates": candidates}


def map_points(bucket: Bucket, plane: tuple[int, int]) -> float:
    """Points of the map of a plane."""
    rows, columns = (
        (ceil(n / bucket.voxels) + taps - 1) * bucket.points for n, taps in zip(plane, bucket.taps, strict=True)
    )
    return float(rows * columns)


def map_work(bucket: Bucket, plane: tuple[int, int]) -> Work:
    """A plane of voxels spread into its map, or summed from it."""
    ny, nx = plane
    line, points = ny * ceil(nx / bucket.voxels) * bucket.points, map_points(bucket, plane)
    moved = ny * nx + 3.0 * line + 2.0 * points
    operations = 2.0 * bucket.voxels * (bucket.taps[1] * line + bucket.taps[0] * points)
    return Work(FLOAT * moved, operations).times(bucket.ranks)


def groups_of(exponents: Sequence[tuple[float, int]], views: int) -> list[int]:
    """Of how many views each correction is; ``exponents``: of ``mart.exponents``."""
    out: list[int] = []
    for _, together in exponents:
        out += [together] * (views // together) + [views % together] * (views % together > 0)
    return out
