"""Images of a real camera: particles, the evenly lit stop, targets of dots. Mean electrons, upright, (rows, columns).

Frames are the laboratory's (``RealCamera.pose``).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation import kernels, real_kernels, real_light
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.patches import Items, Progress, gathered
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.targets import DotTarget
from plenopiv.threads import in_threads

RINGS, AROUND = (0.35, 0.7, 0.9, 1.0), 24  # rays that tell how far a point's light reaches
SPILL = 1.05  # of what they tell
SAMPLES = 64  # rays of a pixel
BANKS = 256  # of rays, of which each pixel takes one


@dataclass(frozen=True)
class Rays:
    """Rays at the microlens plane: (s, t) and slopes ds/dz, dt/dz, and the place ``sensor_mm`` (s, t) that they reach;
    each (n, 2), NaN where stop or rim keep a ray away."""

    st_mm: NDArray[np.float64]
    slopes: NDArray[np.float64]
    sensor_mm: NDArray[np.float64]


def traced(camera: RealCamera, points_mm: ArrayLike, stop_mm: ArrayLike) -> Rays:
    """The rays from points (n, 3) of the laboratory through places (n, 2) in the aperture stop, which is in mm about
    its centre, along the camera's x and y.

    Raises PlenoPIVError for points that are not in the fluid.
    """
    points, stop = np.atleast_2d(np.asarray(points_mm, float)), np.atleast_2d(np.asarray(stop_mm, float))
    n = max(len(points), len(stop))
    position = np.ascontiguousarray(np.broadcast_to(_in_fluid(camera, points), (n, 3)))
    pupil = np.ascontiguousarray(np.broadcast_to(stop * (camera.entrance_pupil_mm[1] / camera.stop_radius_mm), (n, 2)))
    out = np.empty((n, 6))
    in_threads(real_kernels.trace_rays, n, camera.constants, position, pupil, out)
    return Rays(out[:, :2], out[:, 2:4], out[:, 4:])


def sight_lines(camera: RealCamera, st_mm: ArrayLike, stop_mm: ArrayLike) -> tuple[NDArray, NDArray]:
    """The lines in the fluid, points and directions (n, 3) of the laboratory, that reach (s, t) (n, 2) on the microlens
    plane through places (n, 2) in the aperture stop; NaN where the rim is in their way."""
    st, stop = np.atleast_2d(np.asarray(st_mm, float)), np.atleast_2d(np.asarray(stop_mm, float))
    n = max(len(st), len(stop))
    pupil = np.broadcast_to(stop * (camera.entrance_pupil_mm[1] / camera.stop_radius_mm), (n, 2))
    out = np.empty((n, 6))
    in_threads(
        real_kernels.trace_back, n, camera.constants,
        np.ascontiguousarray(np.broadcast_to(st, (n, 2))), np.ascontiguousarray(pupil), out,
    )  # fmt: skip
    return camera.pose.to_laboratory(out[:, :3]), out[:, 3:] @ camera.pose.axes


def real_particle_image(
    camera: RealCamera,
    particles: Particles,
    *,
    rays: int = 20_000,
    seed: int = 0,
    diffraction_nm: float | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """The image of particles in the laboratory: their ``electrons`` are what falls on the sensor where neither rim nor
    sensor cuts their light. Other arguments as ``images.particle_image`` takes them.

    Raises PlenoPIVError for particles that are not in the fluid.
    """
    if rays < 1:
        raise PlenoPIVError(f"simulation: rays = {rays}, give at least 1 ray per particle")
    position = np.ascontiguousarray(_in_fluid(camera, particles.position_mm))
    blur = 0.0 if diffraction_nm is None else _diffraction_sigma_mm(camera, diffraction_nm)
    size = particles.diameter_mm / 4.0
    cam = camera.constants

    def trace(items: Items) -> None:
        in_threads(
            real_light.trace_particles, items.particle.size, *items, cam, position, particles.electrons / rays,
            rays, np.uint64(seed % 2**64), size, camera.blur_mm, blur,
        )  # fmt: skip

    window = _patch_windows(camera, position, size, camera.blur_mm + blur)
    return gathered((camera.sensor.rows, camera.sensor.columns), window, rays, trace, progress)


def real_white_image(
    camera: RealCamera,
    electrons_per_pixel: float = 5000.0,
    *,
    falloff: float = 0.0,
    diffraction_nm: float | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
) -> NDArray[np.float64]:
    """The evenly lit stop under every microlens, cut by the rim where it is: ``electrons_per_pixel`` in a whole pixel.
    ``falloff``: share of light lost in the sensor's corners. ``samples``: rays of each pixel."""
    if not 0.0 <= falloff < 1.0:
        raise PlenoPIVError(f"white image: falloff = {falloff}, give the share of light lost in the corners, 0 to 1")
    image = _seen(camera, samples, seed, np.zeros(17), np.zeros((0, 0, 4)), diffraction_nm)
    column0, row0 = camera.sensor.axis
    c, r = np.arange(image.shape[1]) - column0, np.arange(image.shape[0]) - row0
    image *= 1.0 - falloff * ((c / (column0 + 0.5)) ** 2 + (r[:, None] / (row0 + 0.5)) ** 2) / 2.0
    return electrons_per_pixel * image


def target_image(
    camera: RealCamera,
    target: DotTarget,
    z_mm: float,
    electrons_per_pixel: float = 3000.0,
    *,
    diffraction_nm: float | None = None,
    samples: int = 2 * SAMPLES,
    seed: int = 0,
) -> NDArray[np.float64]:
    """A target at ``z_mm`` in the laboratory: ``electrons_per_pixel`` in a pixel that sees nothing but a dot.

    Raises PlenoPIVError for a target that is not in the fluid.
    """
    axes = camera.pose.axes
    origin = _in_fluid(camera, np.array([[0.0, 0.0, z_mm], [0.0, 0.0, z_mm - target.step_mm]]))[0]
    half = (np.inf, np.inf) if target.half_mm is None else target.half_mm
    plane = np.array([*origin, *axes.T.ravel(), target.pitch_mm, target.step_mm, target.background, *half])
    dots = target.dots(_farthest_mm(camera, z_mm))
    return electrons_per_pixel * _seen(camera, samples, seed, plane, dots, diffraction_nm)


def lit_pixels(camera: RealCamera) -> float:
    """Pixels that a particle in focus lights, which is one microlens' image of the stop."""
    return pi * (camera.micro_image_radius_mm / camera.sensor.pixel_pitch_mm) ** 2


def _seen(
    camera: RealCamera, samples: int, seed: int, plane: NDArray, dots: NDArray, diffraction_nm: float | None
) -> NDArray[np.float64]:
    """The mean brightness that every pixel sees, blurred by diffraction."""
    from plenopiv.simulation.white import blurred

    image = np.empty((camera.sensor.rows, camera.sensor.columns))
    cam, banks, number = camera.constants, np.empty((BANKS, samples, 4)), np.uint64(seed % 2**64)
    in_threads(real_light.sample_pixels, BANKS, banks, cam, number, little=True)
    in_threads(real_light.trace_pixels, len(image), image, cam, banks, number, plane, dots)
    if diffraction_nm is None:
        return image
    return blurred(image, _diffraction_sigma_mm(camera, diffraction_nm) / camera.sensor.pixel_pitch_mm)


def _diffraction_sigma_mm(camera: RealCamera, wavelength_nm: float) -> float:
    """As ``images.diffraction_sigma_mm``."""
    return 0.42 * wavelength_nm * 1e-6 * camera.microlens_focal_length_mm / camera.lattice.pitch_mm


def _in_fluid(camera: RealCamera, points_mm: NDArray) -> NDArray[np.float64]:
    """Points (n, 3) of the laboratory in the camera's frame, if all lie in the fluid, or in front of the camera."""
    position = camera.pose.to_camera(points_mm)
    left, wall = camera.in_front_mm(position), "camera" if camera.medium is None else "window"
    if left.size and not left.min() > 0:
        x, y, z = position.reshape(-1, 3)[int(np.argmin(left))]
        raise PlenoPIVError(
            f"simulation: a point at x = {x:g}, y = {y:g}, z = {z:g} mm of the camera's frame is not in front of the "
            f"{wall}; keep volume and targets in front of it"
        )
    return position


def _farthest_mm(camera: RealCamera, z_mm: float) -> float:
    """How far from the laboratory's axis the camera sees anything of a plane at z, or farther."""
    sensor = camera.sensor
    half = 0.5 * float(np.hypot(sensor.columns, sensor.rows)) * sensor.pixel_pitch_mm
    widest = half * camera.object_distance_mm / camera.image_distance_mm
    blur = abs(camera.pose.origin_mm[2] + z_mm) * (widest + camera.stop_radius_mm) / camera.object_distance_mm
    return 1.5 * (widest + 2 * blur + float(np.hypot(*camera.pose.origin_mm[:2])))


def _patch_windows(
    camera: RealCamera, position: NDArray[np.float64], particle_sigma_mm: float, blur_sigma_mm: float
) -> NDArray[np.int64]:
    """First column, first row, columns and rows of the pixels that each particle's light can reach; (n, 4).

    From where rays through rings of the entrance pupil meet the microlens plane; a microlens moves their light by no
    more than its cell and the gap times their slope.
    """
    sensor, radius = camera.sensor, camera.entrance_pupil_mm[1]
    angle = np.arange(AROUND) * (2 * pi / AROUND)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    pupil = np.concatenate([share * radius * ring for share in RINGS])
    cam = camera.constants._replace(rim=np.inf)
    n, m = len(position), len(pupil)
    out = np.empty((n * m, 6))
    in_threads(real_kernels.trace_rays, n * m, cam, np.repeat(position, m, 0), np.tile(pupil, (n, 1)), out)
    gap = camera.microlens_focal_length_mm
    reached = (out[:, :2] + gap * out[:, 2:4]).reshape(n, m, 2)
    lo, hi = reached.min(1), reached.max(1)
    middle, half = (lo + hi) / 2, SPILL * (hi - lo) / 2
    half += 0.75 * camera.lattice.pitch_mm * (1 + abs(camera.aspect)) + abs(camera.gap_tilt) * gap
    magnification = camera.image_distance_mm / (camera.object_distance_mm - np.minimum(position[:, 2], 0.0))
    half += kernels.LARGEST_DEVIATE * (2 * magnification[:, None] * particle_sigma_mm + blur_sigma_mm)
    corner_a = np.stack(sensor.pixel_from_plane(*(middle - half).T), -1)
    corner_b = np.stack(sensor.pixel_from_plane(*(middle + half).T), -1)
    limits = np.array([sensor.columns, sensor.rows])
    first = np.clip(np.floor(np.minimum(corner_a, corner_b)) - 1, 0, limits).astype(np.int64)
    last = np.clip(np.ceil(np.maximum(corner_a, corner_b)) + 2, 0, limits).astype(np.int64)
    return np.concatenate([first, np.maximum(last - first, 0)], axis=1)
