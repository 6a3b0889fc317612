"""Views of listed voxels through one map of each plane of voxels.

- ``maps``: the maps' sizes, and the weights of a voxel in the points around it
- ``view_pixels``: the pixels of views as the kernels take them
- ``kernels``: planes spread into maps and views read off them, and back
- ``voxel_rows``: rows of voxels spread into a map, and gathered; ``simd``: its inner loops
- ``placing``: where the footprints of pixels are centred on a map
- ``reading``: views read off a map, corrections written there; ``interpolation``: its inner loops
- ``views``: images of views from listed voxels, and voxels corrected by them
"""
