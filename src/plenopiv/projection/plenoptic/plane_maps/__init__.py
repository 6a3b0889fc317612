"""Views of listed voxels through one map of each plane of voxels.

- ``maps``: the maps' sizes, and the shares of a voxel in the points around it
- ``view_pixels``: the pixels of views as the kernels take them
- ``kernels``: planes spread into maps and views read off them, and back
- ``placing``: where the footprints of pixels are centred on a map; ``reading``: views read off maps, and written there
- ``voxel_rows``: rows of voxels spread into maps, and gathered; ``interpolation``, ``simd``: inner loops
- ``views``: images of views from listed voxels, and voxels corrected by them
"""
