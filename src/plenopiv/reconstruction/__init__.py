"""From the images of a frame, of one camera or of several, to a volume.

- ``reconstruct``: one frame, whatever the cameras
- ``candidates``: which voxels MART starts from (dense ray tracing, lines of sight)
- ``mart``: multiplicative corrections, a few views at a time (``thinning``: voxels left out)
- ``tiles``: a volume in parts; ``noise``: of the pixels; ``focus``: weights of planes near focus; ``settings``
"""
