"""What the reconstruction of a frame of a plenoptic camera moves and computes on a device: ``work`` of its stages.

``images``: a plane spread into its map and read off it, for each group of views; ``back``: listed voxels ask the
microlenses about them; ``candidates``: dense ray tracing. Buckets of planes tell how large maps are, and how many
products a point takes, those of voxels how many microlenses they ask.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod

from plenopiv.device.asking import row_by_row
from plenopiv.device.candidates import LONGEST, VIEWS, run_length
from plenopiv.device.plane_tables import Bucket
from plenopiv.device.planes import map_units
from plenopiv.device.voxel_tables import Asking
from plenopiv.device.work import FLOAT, Work

TAP = 4.0  # operations of a voxel's product with a weight: it is read from a cache, half as fast as it is multiplied
PLACE = 40.0  # operations of a pixel: where it lies on a map, its lit share, what is read there
READ = 14.0  # floats: the pixel's lens, its place, four points of the map
LISTED = 0.06  # share of all voxels that are listed, where they are densely seeded
ASKED = 400.0  # operations of a listed voxel and a microlens: its place, and seven reads, each as long as fifty
OF_VIEW = 7.0  # floats of a listed voxel and a view: its place, its sum; microlenses and weights come from a cache
CHANGED = 20.0  # floats of a listed voxel and a correction: its number and place, itself, which lies alone in memory
STARTED = 0.5  # of a program's start: that of one of its steps; fits four sizes on two machines
JUDGED = 90.0  # operations of a voxel and a pixel that may rule it out: its place, an area
SWEPT = 6.0  # floats of a voxel that is judged by a group of views, to list what is left
LEFT = 0.065  # share of voxels that the first views that judge leave to the others, on an average


def reconstruction(
    plane: tuple[int, int],
    buckets: Sequence[Bucket],
    asking: Sequence[Asking],
    pixels: int,
    groups: Sequence[int],
    judged: Sequence[tuple[int, int]],
    judging: int,
    listed: float = LISTED,
) -> Mapping[str, Work]:
    """By stage, of one frame on planes of (ny, nx) voxels, of which a share is ``listed``. ``pixels``: of a view;
    ``groups``: of how many views each correction of the volume is, all iterations; ``judged``: numbers of planes, and
    how many microlenses of a view may rule out a voxel of them; ``judging``: how many views do."""
    images, back, used, times = Work(), Work(), sum(groups), len(groups)
    area = float(prod(plane))
    placed = Work(FLOAT * READ * pixels, PLACE * pixels)
    for bucket in buckets:
        steps = Work(calls=STARTED * (4 + bucket.points**2 * bucket.members * bucket.voxels**2))
        images += ((map_work(bucket, plane) + steps).times(times) + placed.times(used)).times(bucket.planes)
    for each in asking:
        lenses = prod(each.window)
        passes = each.window[0] if row_by_row(each) else 1
        asked = Work(FLOAT * OF_VIEW * passes * listed * area, ASKED * lenses * listed * area, STARTED * (passes + 2))
        changed = Work(FLOAT * CHANGED * listed * area, calls=STARTED * 6)
        back += (changed.times(times) + (asked + placed).times(used)).times(each.planes)
    candidates = Work()
    groups_judging = -(-judging // VIEWS)
    voxels = judged_voxels(int(area), groups_judging)
    for planes, lenses in judged:
        one = Work(FLOAT * SWEPT * voxels / VIEWS, JUDGED * lenses * voxels, 3.0 * groups_judging)
        candidates += one.times(planes)
    return {"images": images + Work(calls=times), "back": back, "candidates": candidates}


def judged_voxels(area: int, groups: int) -> float:
    """How often a view judges a voxel of a plane of ``area`` voxels; ``groups`` of VIEWS views judge one after the
    other: the first all, each other what is left, a whole run of voxels at the least."""
    longest = min(LONGEST, 1 << (area - 1).bit_length())
    run = run_length(int(LEFT * area), longest)
    return VIEWS * (area + (groups - 1) * max(run, LEFT * area + run / 2))


def map_work(bucket: Bucket, plane: tuple[int, int]) -> Work:
    """The planes of a group spread into their map."""
    units, area = prod(map_units(bucket, plane)), prod(plane)
    phases, places = bucket.points**2, bucket.members * bucket.voxels**2
    copied = 2.0 * bucket.members * area
    if places == 1:
        moved = copied + phases * (area + units)
    else:
        moved = copied + phases * (bucket.members * area + 2.0 * places * units)
    return Work(FLOAT * moved, TAP * prod(bucket.taps) * phases * places * units)


def groups_of(exponents: Sequence[tuple[float, int]], views: int) -> list[int]:
    """Of how many views each correction is; ``exponents``: of ``mart.exponents``."""
    out: list[int] = []
    for _, together in exponents:
        out += [together] * (views // together) + [views % together] * (views % together > 0)
    return out
