"""Calibration: the microlens lattice from a white image, and the file that keeps it; pinhole cameras from a board.

white_image.py    find_lattice: a white image to a LatticeFit
spectrum.py       kind, pitch, rotation and offset from the spectrum: the first estimate
array_fit.py      where lenses are, as a function of their numbers
cat_eyes.py       chief rays of micro-images that the main lens' rim clips
verdict.py        not white, too dim, overexposed, too distorted; centroids as a cross-check
micro_images.py   the centre of every micro-image by a least-squares fit
lattice_fit.py    LatticeFit; save_lattice and load_lattice
dot_board.py      dots of a calibration board in an image, and which is which
pinhole_fit.py    calibrate_pinhole: images of a board at several depths to a PinholeFit
"""

from plenopiv.calibration.lattice_fit import LatticeFit, load_lattice, save_lattice
from plenopiv.calibration.pinhole_fit import PinholeFit, calibrate_pinhole
from plenopiv.calibration.white_image import find_lattice

__all__ = ["LatticeFit", "PinholeFit", "calibrate_pinhole", "find_lattice", "load_lattice", "save_lattice"]
