"""Views of listed voxels, voxel by voxel and microlens by microlens: for rays, and as the reference of plane maps.

- ``kernels``: for each listed voxel the microlenses that it lights
- ``slots``: which those are, and where
- ``views``: images of views from listed voxels, and voxels corrected by them
"""
