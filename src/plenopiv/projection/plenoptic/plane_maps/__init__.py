"""Views of listed voxels through one map of each plane of voxels.

- ``maps``: the maps' sizes, and the shares of a voxel in the points around it
- ``view_pixels``: the pixels of views as the kernels take them
- ``kernels``: planes spread into maps and views read off them, and back
- ``voxel_rows``, ``interpolation``, ``simd``: their inner loops
- ``views``: images of views from listed voxels, and voxels corrected by them
"""
