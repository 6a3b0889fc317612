"""Measures against a known truth: velocity fields against particles, volumes against volumes, centres of particles.

    truth.py      displacements that a perfect measurement would find, from particles known in both frames
    velocity.py   errors of a velocity field in voxels: RMS and bias by axis and depth, gross errors, stated uncertainty
    volumes.py    reconstruction quality Q (Elsinga et al. 2006), the exact volume it needs, centres of particles

A run never comes here: it has no truth. Simulations and benchmarks do.
"""

from plenopiv.accuracy.truth import TrueDisplacements, true_displacements
from plenopiv.accuracy.velocity import Band, Errors, Score, score_velocity
from plenopiv.accuracy.volumes import exact_volume, intensity_centre_mm, reconstruction_quality

__all__ = [
    "Band",
    "Errors",
    "Score",
    "TrueDisplacements",
    "exact_volume",
    "intensity_centre_mm",
    "reconstruction_quality",
    "score_velocity",
    "true_displacements",
]
