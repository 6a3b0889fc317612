"""What a camera could resolve, before anything is recorded: the analysis of the paper's section 2 for any camera.

    light_columns.py   rays through the portions' boundaries, the microlens that each one meets, how far a point can
    move blocks.py          the cells that those rays cut object space into: polygons, areas, extents in a plane
    resolution.py      free shift along x, y and z against depth; mean sizes of blocks

It knows geometry alone. How much finer than a block the split of light between microlenses resolves, given noise, is
the subject of ``accuracy.bound``.
"""

from plenopiv.design.blocks import Blocks, Plane, blocks, xy_plane, yz_plane
from plenopiv.design.light_columns import boundary_lines, codes, corners_mm, fan_mm, free_shift_mm, portion_edges_mm
from plenopiv.design.resolution import (
    BlockSizes,
    FreeShift,
    block_sizes,
    mean_free_shift,
    places_mm,
    resolution_x,
    resolution_y,
    resolution_z,
)

__all__ = [
    "BlockSizes",
    "Blocks",
    "FreeShift",
    "Plane",
    "block_sizes",
    "blocks",
    "boundary_lines",
    "codes",
    "corners_mm",
    "fan_mm",
    "free_shift_mm",
    "mean_free_shift",
    "places_mm",
    "portion_edges_mm",
    "resolution_x",
    "resolution_y",
    "resolution_z",
    "xy_plane",
    "yz_plane",
]
