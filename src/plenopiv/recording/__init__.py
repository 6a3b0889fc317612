"""A recording: raw frames of one camera and its white image, read from files and checked one by one.

- ``sources``: where an image is: a file, one of its pages, half of a double-height image, a data set
- ``tiff``: TIFF files; ``formats``: PNG, NumPy, HDF5 and LaVision files
- ``pairs``: which images belong together, from patterns of file names
- ``naming``: what names say: dark, background and white images, both frames of a pair
- ``recording``: the frames, their pairs and the white image
"""

from plenopiv.recording.pairs import find_frames, natural_order
from plenopiv.recording.recording import Recording
from plenopiv.recording.sources import ImageSource, image_size, read_image
from plenopiv.recording.tiff import tiff_tags

__all__ = ["ImageSource", "Recording", "find_frames", "image_size", "natural_order", "read_image", "tiff_tags"]
