"""Dense ray tracing: the voxels that could hold a particle at all.

- ``rule``: which voxels stay, plane by plane
- ``kernels``: voxels ruled out by single pixels
- ``in_focus``: voxels that lie across microlenses in focus, judged by all of their pixels together
"""
