"""Tracer particles: where they are and how much light each sends through the main lens."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits

MOST = 30_000_000  # particles


@dataclass(frozen=True)
class Particles:
    """Particles at one instant.

    ``position_mm`` float64 (n, 3) as (x, y, z) in the object frame; ``electrons`` float64 (n,), the mean number that a
    particle's light frees in the sensor (quantum efficiency included) when all of its image falls on it;
    ``diameter_mm`` the particle's e^-2 diameter (4 standard deviations) of a Gaussian across the line of sight, 0 for
    points.
    """

    position_mm: NDArray[np.float64]
    electrons: NDArray[np.float64]
    diameter_mm: float = 0.0

    def __post_init__(self) -> None:
        position = np.ascontiguousarray(self.position_mm, dtype=np.float64)
        if position.ndim != 2 or position.shape[1] != 3:
            raise PlenoPIVError(f"particles: position_mm has shape {position.shape}, give (n, 3) as x, y, z in mm")
        electrons = np.ascontiguousarray(np.broadcast_to(np.asarray(self.electrons, np.float64), position.shape[:1]))
        object.__setattr__(self, "position_mm", position)
        object.__setattr__(self, "electrons", electrons)
        if not (np.isfinite(position).all() and np.isfinite(electrons).all() and (electrons >= 0).all()):
            raise PlenoPIVError("particles: positions and electrons must be finite numbers, electrons not negative")
        if not self.diameter_mm >= 0:
            raise PlenoPIVError(f"particles: diameter_mm = {self.diameter_mm}, give 0 (points) or more")

    def moved_to(self, position_mm: NDArray) -> Particles:
        """The same particles elsewhere; (n, 3) in mm."""
        return Particles(position_mm, self.electrons, self.diameter_mm)


def pixels_lit_in_focus(camera: PlenopticCamera) -> float:
    """Pixels in one micro-image of the aperture, pi/4 (P_m e / p_p)^2: what a particle in focus lights."""
    return pi * camera.aperture_radius_px**2


def particle_count(camera: PlenopticCamera, limits_mm: Limits, particles_per_microlens: float) -> int:
    """Particles in a box at a density in ppm: particles in the seeded field over the microlenses that cover it.

    The field's area is taken in the focal plane: n = ppm * (x width * y width) M^2 / (area of a microlens' cell).
    """
    (x0, x1), (y0, y1), _ = limits_mm
    field_mm2 = (x1 - x0) * (y1 - y0) * camera.main_lens.magnification**2
    return round(particles_per_microlens * field_mm2 / camera.lattice.cell_area_mm2)


def seed_box(
    camera: PlenopticCamera,
    limits_mm: Limits,
    particles_per_microlens: float,
    rng: np.random.Generator,
    *,
    electrons: float | None = None,
    electrons_per_pixel: float | None = None,
    electrons_spread: float = 0.0,
    diameter_mm: float = 0.0,
) -> Particles:
    """Particles at uniformly random places of a box ``((x lo, x hi), (y lo, y hi), (z lo, z hi))`` in mm.

    The light is given either as the mean ``electrons`` of a particle or as ``electrons_per_pixel``, the mean number in
    a lit pixel of a particle in focus (see ``pixels_lit_in_focus``; out of focus the same light covers more pixels).
    ``electrons_spread`` is the relative standard deviation between particles, log-normal.

    Raises PlenoPIVError for empty boxes, negative densities and when not exactly one brightness is given.
    """
    for axis, (lo, hi) in zip("xyz", limits_mm, strict=True):
        if not hi > lo:
            raise PlenoPIVError(f"seeding: {axis} limits [{lo}, {hi}] mm are empty, give them as [low, high]")
    if not particles_per_microlens > 0:
        raise PlenoPIVError(f"seeding: particles_per_microlens = {particles_per_microlens}, give a positive number")
    if (electrons is None) == (electrons_per_pixel is None):
        raise PlenoPIVError("seeding: give one of electrons (per particle) and electrons_per_pixel")
    if not electrons_spread >= 0:
        raise PlenoPIVError(f"seeding: electrons_spread = {electrons_spread}, give 0 or a positive relative deviation")
    n = particle_count(camera, limits_mm, particles_per_microlens)
    if n < 1:
        raise PlenoPIVError(
            f"seeding: {particles_per_microlens} particles per microlens leave none in this box, add some"
        )
    if n > MOST:
        sides = " x ".join(f"{hi - lo:.3g}" for lo, hi in limits_mm)
        raise PlenoPIVError(
            f"seeding: {n:.3g} particles in {sides} mm are too many; the box is as much larger than the volume as the "
            "flow moves between frames: are velocity, dt_s and margin_mm in their units?"
        )
    lo, hi = np.array(limits_mm, float).T
    position = rng.uniform(lo, hi, (n, 3))
    mean = electrons if electrons is not None else electrons_per_pixel * pixels_lit_in_focus(camera)  # type: ignore[operator]
    sigma = sqrt(log(1.0 + electrons_spread**2))
    # drawn even without a spread, so that the spread does not move what is drawn after it
    light = mean * np.exp(sigma * rng.standard_normal(n) - 0.5 * sigma**2)
    return Particles(position, light, diameter_mm)
