"""Rays between voxels and pixels: the one place where weights are computed, forward and back.

- ``protocol``: what reconstruction uses, whatever the cameras
- ``plenoptic``: the views of a plenoptic camera
- ``several_cameras``: the views of several plenoptic cameras around a volume
- ``pinhole``: pinhole cameras around a volume (Tomo-PIV)
- ``correction``: the factor by which MART multiplies a voxel
"""
