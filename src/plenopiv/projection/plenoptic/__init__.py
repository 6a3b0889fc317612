"""A plenoptic camera: its views are portions of one main lens.

- ``geometry``: camera and voxel grid as the few numbers that a kernel needs, with the derivation
- ``cell_areas``: the area of a patch of light inside a microlens' cell
- ``pixel_weights``: the weight of a voxel in a pixel, whole, cut by the aperture's rim, or by rays
- ``plane_maps``: views of listed voxels by exact areas, through one map of each plane
- ``by_voxel``: the same voxel by voxel and microlens by microlens, for rays and as the maps' reference
- ``candidates``: dense ray tracing, which voxels could hold a particle at all
- ``projector``: all of it as one ``Projection``
"""
