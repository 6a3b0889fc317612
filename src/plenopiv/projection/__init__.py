"""Rays between voxels and pixels: the one place where weights are computed, forward and back.

- ``footprint``: scalar leaves, the area of a patch of light inside a microlens' cell
- ``pixels``: what a pixel collects, whole, cut by the aperture's rim, or by rays
- ``geometry``: camera and grid as the few numbers that a kernel needs, with the derivation
- ``dense``: CPU loops over planes of voxels, from the microlens' side
- ``sparse``: CPU loops over listed voxels, from the voxel's side
- ``projector``: the interface that reconstruction uses
"""
