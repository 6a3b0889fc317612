"""Images of particles by Monte-Carlo ray tracing through the thin-lens plenoptic camera.

Source: Shi, Ding & New (2016), Eqs. 1-5 and section 2. Every particle sends rays to all of the main lens' aperture;
each is traced to its microlens and to its pixel, without any approximation beyond the paper's linear Gaussian optics.
The light of a particle does not depend on its depth (the lens' solid angle changes by 2 % per mm at S_o = 100 mm).
A main lens that blurs (``PlenopticCamera.blur_mm``) displaces each ray on the microlens plane.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation import kernels
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.patches import Items, Progress, gathered
from plenopiv.threads import in_threads

Sampling = Literal["stratified", "random"]


def diffraction_sigma_mm(camera: PlenopticCamera, wavelength_nm: float) -> float:
    """Standard deviation in mm of the Gaussian nearest to a microlens' Airy disc: 0.42 lambda f_l / p_l."""
    return 0.42 * wavelength_nm * 1e-6 * camera.microlens_focal_length_mm / camera.lattice.pitch_mm


def check_simulated(camera: PlenopticCamera) -> None:
    """Raise PlenoPIVError for a camera with a rim or an array that is not regular: images would be another's, as
    neither is in the ray tracing."""
    if camera.rim is not None:
        raise PlenoPIVError(
            f"simulation: camera.rim = {camera.rim} is not simulated; use replace(camera, rim=None), or "
            "simulation.real_camera.RealCamera with stop_mm and rim_radius_mm"
        )
    if camera.lattice.map is not None:
        raise PlenoPIVError(
            f"simulation: camera.lattice.map, of degree {camera.lattice.map.degree}, is not simulated; use a regular "
            "lattice, or simulation.real_camera.RealCamera with aspect and array_distortion"
        )


def particle_image(
    camera: PlenopticCamera,
    particles: Particles,
    *,
    rays: int = 20_000,
    sampling: Sampling = "stratified",
    seed: int = 0,
    diffraction_nm: float | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Mean electrons of every pixel, upright, float64 (rows, columns).

    ``rays`` go out from each particle. ``sampling`` is "stratified" (a golden-angle spiral over the aperture, turned
    and shifted at random for each particle) or "random" (independent rays; the error falls with the square root of
    their number). ``diffraction_nm`` is a wavelength at which each ray's hit is blurred by its microlens' diffraction
    (``diffraction_sigma_mm``); None leaves it out. The same seed gives the same image on any number of threads.
    ``progress(done, total)`` is called with particles done.

    Raises PlenoPIVError for particles at or behind the main lens, for settings out of range, and for a camera that is
    not simulated (``check_simulated``).
    """
    check_simulated(camera)
    if rays < 1:
        raise PlenoPIVError(f"simulation: rays = {rays}, give at least 1 ray per particle")
    if sampling not in ("stratified", "random"):
        raise PlenoPIVError(f"simulation: sampling '{sampling}' is unknown, give 'stratified' or 'random'")
    sensor, lens, lattice = camera.sensor, camera.main_lens, camera.lattice
    x, y, z = (np.ascontiguousarray(c) for c in particles.position_mm.T)
    if z.size and z.max() >= lens.object_distance_mm:
        raise PlenoPIVError(
            f"simulation: a particle at z = {z.max():g} mm is not in front of the main lens, "
            f"keep z below {lens.object_distance_mm:g} mm"
        )
    spread, scale = np.asarray(camera.spread(z), float), np.asarray(camera.scale(z), float)
    blur = 0.0 if diffraction_nm is None else diffraction_sigma_mm(camera, diffraction_nm)
    size = particles.diameter_mm / 4.0

    window = _patch_windows(camera, x, y, spread, scale, size, blur)
    column0, row0 = sensor.axis

    def trace(items: Items) -> None:
        in_threads(
            kernels.trace_items, items.particle.size,
            *items,
            x, y, spread, scale, particles.electrons / rays,
            rays, sampling == "stratified", np.uint64(seed % 2**64),
            0.5 * lens.aperture_mm, size, camera.blur_mm, blur,
            lattice.kind == "hexagonal", lattice.pitch_mm, lattice.rotation_rad,
            lattice.offset_mm[0], lattice.offset_mm[1],
            camera.image_scale, column0, row0, sensor.pixel_pitch_mm,
        )  # fmt: skip

    return gathered((sensor.rows, sensor.columns), window, rays, trace, progress)


def _patch_windows(
    camera: PlenopticCamera,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    spread: NDArray[np.float64],
    scale: NDArray[np.float64],
    particle_sigma_mm: float,
    blur_sigma_mm: float,
) -> NDArray[np.int64]:
    """First column, first row, columns and rows of the pixels that each particle's light can reach; (n, 4).

    A ray's hit differs from s (1 + e) by (S - s) - e u, at most half a cell's diagonal and half a micro-image.
    """
    sensor, radius, e = camera.sensor, 0.5 * camera.main_lens.aperture_mm, camera.image_scale
    reach = np.abs(spread) * radius * (1 + e) + 0.7072 * camera.lattice.pitch_mm + e * radius
    sigma = np.abs(scale) * (1 + e) * particle_sigma_mm + camera.blur_mm + blur_sigma_mm
    reach += kernels.LARGEST_DEVIATE * sigma
    column, row = sensor.pixel_from_plane(scale * x * (1 + e), scale * y * (1 + e))
    half = reach / sensor.pixel_pitch_mm + 1.0
    limits = np.array([sensor.columns, sensor.rows])
    centre = np.stack([column, row], -1)
    lo = np.clip(np.floor(centre - half[:, None]), 0, limits).astype(np.int64)
    hi = np.clip(np.ceil(centre + half[:, None]) + 1, 0, limits).astype(np.int64)
    return np.concatenate([lo, np.maximum(hi - lo, 0)], axis=1)
