"""Images of a target of dots at known z: what the camera is in its laboratory.

- ``board``: the target, and one image of it
- ``find``: bright spots in a refocused picture
- ``dot_table``, ``dot_image``: a dot in all views, and its place in lens space
- ``numbering``: which dot is which
- ``fit``: the dots of all planes
- ``optics_fit``: lengths, window, pose and distortion from them
- ``pupil``: exit pupil and stop from the outlines of micro-images
- ``calibrated``: all of it, with residuals
"""
