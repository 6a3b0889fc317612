"""Calibration: the microlens lattice from a white image, and the file that keeps it.

white_image.py    find_lattice: a white image to a LatticeFit
spectrum.py       kind, pitch, rotation and offset from the spectrum: the first estimate
micro_images.py   the centre of every micro-image by a least-squares fit
lattice_fit.py    LatticeFit; save_lattice and load_lattice
"""

from plenopiv.calibration.lattice_fit import LatticeFit, load_lattice, save_lattice
from plenopiv.calibration.white_image import find_lattice

__all__ = ["LatticeFit", "find_lattice", "load_lattice", "save_lattice"]
