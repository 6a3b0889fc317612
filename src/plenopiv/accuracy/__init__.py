"""Measures against a known truth: velocity fields against particles, volumes against volumes, centres of particles.

    truth.py      displacements that a perfect measurement would find, from particles known in both frames
    velocity.py   errors of a velocity field in voxels: RMS and bias by axis and depth, gross errors, stated uncertainty
    profile.py    errors against a known flow, plane by plane
    point_light.py   where a point's light goes and how that changes with its position, in double precision
    bound.py      Cramer-Rao bound of positions and displacements: the least error that the pixels allow
    volumes.py    reconstruction quality Q (Elsinga et al. 2006), the exact volume it needs, ghosts, centres

A run never comes here: it has no truth. Simulations and benchmarks do.
"""

from plenopiv.accuracy.bound import (
    FieldBounds,
    PositionBound,
    field_bounds,
    fisher_information,
    pixel_variance,
    position_bound,
    standard_deviation,
    window_bound,
)
from plenopiv.accuracy.point_light import PointLight, point_light
from plenopiv.accuracy.profile import DepthProfile, error_by_depth
from plenopiv.accuracy.truth import TrueDisplacements, true_displacements
from plenopiv.accuracy.velocity import Band, Errors, Score, pooled, score_velocity
from plenopiv.accuracy.volumes import exact_volume, ghost_light, intensity_centre_mm, reconstruction_quality

__all__ = [
    "Band",
    "DepthProfile",
    "Errors",
    "FieldBounds",
    "PointLight",
    "PositionBound",
    "Score",
    "TrueDisplacements",
    "error_by_depth",
    "exact_volume",
    "field_bounds",
    "fisher_information",
    "ghost_light",
    "intensity_centre_mm",
    "pixel_variance",
    "point_light",
    "pooled",
    "position_bound",
    "reconstruction_quality",
    "score_velocity",
    "standard_deviation",
    "true_displacements",
    "window_bound",
]
