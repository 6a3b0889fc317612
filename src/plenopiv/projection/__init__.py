"""Rays between voxels and pixels: the one place where weights are computed, forward and back.

- ``footprint``: scalar leaves, the area of a patch of light inside a microlens' cell
- ``pixels``: what a pixel collects, whole, cut by the aperture's rim, or by rays
- ``geometry``: camera and grid as the few numbers that a kernel needs, with the derivation
- ``pruning``: which voxels could hold a particle at all (``borders``: those across microlenses in focus)
- ``mapped``: views of listed voxels by exact areas, through a map of each plane (``maps``, ``views``, ``strips``,
  ``simd``)
- ``sparse``: the same voxel by voxel and lens by lens, for rays and as the maps' reference
- ``projector``: the views of a plenoptic camera
- ``shadows``, ``pinhole``: the same for pinhole cameras around a volume, each of which is a view
- ``correction``: what a voxel is multiplied by
- ``protocol``: what MART uses of either
"""
