"""The Cramer-Rao bound of particle positions: the least error of any unbiased estimate from the raw pixels.

Source: Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory* (1993), sections 3.7 and 3.9. Pixel p
expects  mu_p = background + sum_i E_i w_p(x_i)  electrons and scatters about them with the variance

    V_p = mu_p + read noise^2 + (quantisation step)^2 / 12.

The parameters are x, y, z and E of every particle, and their Fisher information is

    J = sum_p (d mu_p / d theta) (d mu_p / d theta)^T / V_p.

No unbiased estimator has a standard deviation below sqrt((J^-1)_kk). That V changes with theta holds information too;
for Poisson counts the J above is the whole of it, so nothing is added.

J takes as known what no experiment knows exactly: the number of particles, optics and lattice, and positions close
enough for the linearisation. The bound is a reference, not a forecast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import ceil, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from plenopiv.accuracy.point_light import PointLight, point_light
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import as_points

Array = NDArray[np.float64]
SINGULAR = 1e-12  # share of a parameter's information that counts as none


class Noise(Protocol):
    """A sensor's noise: ``gain`` in counts per electron, ``read_noise_electrons`` RMS (``simulation.SensorNoise``)."""

    @property
    def gain(self) -> float:
        """Counts per electron."""

    @property
    def read_noise_electrons(self) -> float:
        """RMS of a dark pixel."""


@dataclass(frozen=True)
class PositionBound:
    """Fisher information of the pixels on one particle's position.

    ``information`` (3, 3) per mm^2, along x, y, z: the Schur complement of J in which all other parameters are
    unknown. ``one_lens``: all of the light goes through a single microlens, so that only the place and size of its
    micro-image depend on the position.
    """

    information: Array
    one_lens: bool

    @property
    def std_mm(self) -> Array:
        """Least standard deviation along x, y, z (3,); inf where the pixels do not determine the position."""
        return standard_deviation(self.information)


@dataclass(frozen=True)
class FieldBounds:
    """Fisher information on n particles of a field, at ``position_mm`` (n, 3).

    ``isolated`` and ``overlapping``, (n, 3, 3) per mm^2: information on each one's position (see ``PositionBound``),
    alone in the image and with its neighbours, their positions and light unknown too. ``one_lens`` (n,): see there.
    ``neighbours`` (n,): particles that share its pixels.
    """

    position_mm: Array
    isolated: Array
    overlapping: Array
    one_lens: NDArray[np.bool_]
    neighbours: NDArray[np.int64]


def standard_deviation(information: ArrayLike) -> Array:
    """Square roots of the inverse's diagonal, (..., 3) mm, of information (..., 3, 3) per mm^2; inf where singular."""
    j = np.asarray(information, np.float64)
    known = np.sqrt(np.maximum(np.diagonal(j, axis1=-2, axis2=-1), np.finfo(float).tiny))
    value, vector = np.linalg.eigh(j / known[..., None] / known[..., None, :])
    variance = (vector**2 / np.maximum(value, SINGULAR)[..., None, :]).sum(-1)
    return np.where(variance < 1e-3 / SINGULAR, np.sqrt(variance) / known, np.inf)


def pixel_variance(mean_electrons: ArrayLike, noise: Noise) -> Array:
    """V in electrons^2 of pixels that expect ``mean_electrons``: shot noise, read noise and rounding to counts."""
    return np.asarray(mean_electrons, np.float64) + noise.read_noise_electrons**2 + 1.0 / (12.0 * noise.gain**2)


def fisher_information(
    lights: Sequence[PointLight], electrons: ArrayLike, noise: Noise, background_electrons: float = 0.0
) -> Array:
    """J of n particles, (4n, 4n): x, y, z (per mm) and ln E of the first particle, then of the next.

    ``lights``: where each one's light goes (``point_light``); ``electrons`` (n,): how much it is.
    """
    count = [len(light.pixel) for light in lights]
    lit, row = np.unique(np.concatenate([light.pixel for light in lights]), return_inverse=True)
    own = np.repeat(np.asarray(electrons, np.float64), count)
    share = np.concatenate([light.share for light in lights])
    gradient = np.concatenate([light.gradient for light in lights])
    mean = background_electrons + np.bincount(row, own * share, len(lit))
    derivative = own[:, None] * np.column_stack([gradient, share]) / np.sqrt(pixel_variance(mean, noise))[row, None]
    column = 4 * np.repeat(np.arange(len(lights)), count)[:, None] + np.arange(4)
    whitened = csr_array((derivative.ravel(), (np.repeat(row, 4), column.ravel())), shape=(len(lit), 4 * len(lights)))
    return (whitened.T @ whitened).toarray()


def position_bound(
    camera: PlenopticCamera,
    position_mm: ArrayLike,
    electrons: float,
    noise: Noise,
    *,
    background_electrons: float = 0.0,
    neighbours_mm: ArrayLike | None = None,
    neighbour_electrons: ArrayLike | None = None,
) -> PositionBound:
    """Bound of a particle at (x, y, z) mm that frees ``electrons`` in all, its light a nuisance parameter.

    ``background_electrons``: known stray light of a pixel. ``neighbours_mm`` (n, 3): other particles, x, y, z and light
    of which are unknown as well (those that share no pixel with the particle do not count); ``neighbour_electrons``: a
    number or (n,), as bright as the particle if left out.

    Raises:
        PlenoPIVError: no light, a particle that no pixel sees or one that is not in front of the main lens.
    """
    if not electrons > 0:
        raise PlenoPIVError(f"accuracy: electrons = {electrons}, give the positive number that a particle frees in all")
    light = point_light(camera, position_mm)
    others = np.empty((0, 3)) if neighbours_mm is None else as_points("accuracy", neighbours_mm)
    brightness = np.broadcast_to(electrons if neighbour_electrons is None else neighbour_electrons, len(others))
    lights, light_of = [light], [float(electrons)]
    for other, own in zip((point_light(camera, p) for p in others), brightness, strict=True):
        if _share_pixels(light, other):
            lights.append(other)
            light_of.append(float(own))
    return PositionBound(_of_first(lights, np.array(light_of), noise, background_electrons), light.one_lens)


def field_bounds(
    camera: PlenopticCamera,
    particles_per_microlens: float,
    z_mm: tuple[float, float],
    electrons: float,
    noise: Noise,
    rng: np.random.Generator,
    *,
    particles: int = 64,
    background_electrons: float = 0.0,
) -> FieldBounds:
    """Bounds of about ``particles`` particles of a random field between the depths ``z_mm``, around the optical axis.

    The field is as wide as any neighbour of theirs can be away, on a sensor that holds it all; every particle frees
    ``electrons``. A particle's information is joined with that of all particles that share pixels with it. *Their*
    further neighbours are left out, which makes the bound about one percent too low (docs/bound.md).

    Raises:
        PlenoPIVError: no particles, an empty range of depths, or one that reaches the main lens.
    """
    lo, hi = z_mm
    if not (particles_per_microlens > 0 and hi > lo and particles > 0):
        raise PlenoPIVError(
            f"accuracy: {particles_per_microlens} particles per microlens between z = {lo} and {hi} mm hold no "
            "particle, give a positive density and depths as (low, high)"
        )
    m, lattice = abs(camera.main_lens.magnification), camera.lattice
    per_mm2 = particles_per_microlens * m**2 / lattice.cell_area_mm2
    blur_mm = float(np.abs(camera.spread(np.array(z_mm))).max()) * 0.5 * camera.main_lens.aperture_mm
    chosen = 0.5 * sqrt(particles / per_mm2)  # half widths, mm
    half = chosen + (2.0 * blur_mm + 2.0 * lattice.pitch_mm) / abs(float(camera.scale(lo)))
    camera = _with_sensor_for(camera, half, max(abs(float(camera.scale(hi))), m), blur_mm)

    n = round(per_mm2 * (2.0 * half) ** 2)
    position = rng.uniform((-half, -half, lo), (half, half, hi), (n, 3))
    spread, scale = np.asarray(camera.spread(position[:, 2])), np.asarray(camera.scale(position[:, 2]))
    image = scale[:, None] * position[:, :2]
    radius = 0.5 * camera.main_lens.aperture_mm
    light = cache(lambda k: point_light(camera, position[k]))
    isolated, overlapping, one_lens, neighbours = [], [], [], []
    targets = np.flatnonzero(np.abs(position[:, :2]).max(1) <= chosen)
    for k in targets:
        # lines of sight of two particles meet in the aperture, give or take a microlens
        meet = np.abs(spread - spread[k]) * radius + 2.0 * lattice.pitch_mm
        near = np.flatnonzero(np.hypot(*(image - image[k]).T) <= meet)
        lights = [light(k), *(light(i) for i in near if i != k and _share_pixels(light(k), light(i)))]
        isolated.append(_of_first(lights[:1], np.array([electrons]), noise, background_electrons))
        overlapping.append(_of_first(lights, np.full(len(lights), electrons), noise, background_electrons))
        one_lens.append(lights[0].one_lens)
        neighbours.append(len(lights) - 1)
    return FieldBounds(
        position[targets],
        np.reshape(isolated, (-1, 3, 3)),
        np.reshape(overlapping, (-1, 3, 3)),
        np.array(one_lens, bool),
        np.array(neighbours, np.int64),
    )


def window_bound(information: ArrayLike, particles: float) -> Array:
    """Bound of the displacement of a window that holds ``particles`` particles, mm along x, y, z.

    ``information`` (n, 3, 3) per mm^2: of positions as they occur in the window. All particles of the window move
    alike, each one's displacement is the difference of two frames, and the best mean weighs it with its information:
    the covariance is 2 (N mean(information))^-1. A particle whose x and z are only known together still counts,
    together with others. Particles count as independent, and all of them are in both frames.

    Raises:
        PlenoPIVError: no information was given.
    """
    j = np.asarray(information, np.float64)
    if len(j) == 0:
        raise PlenoPIVError("accuracy: no particle to bound a window with, give at least one")
    return np.sqrt(2.0) * standard_deviation(particles * j.mean(0))


def _share_pixels(a: PointLight, b: PointLight) -> bool:
    return bool(np.isin(a.pixel, b.pixel, assume_unique=True).any())


def _of_first(lights: Sequence[PointLight], electrons: Array, noise: Noise, background_electrons: float) -> Array:
    """Information on the first particle's x, y, z (3, 3), all other parameters unknown: a Schur complement of J."""
    if len(lights[0].pixel) == 0:
        raise PlenoPIVError("accuracy: no pixel of the sensor sees the particle, move it into the field of view")
    j = fisher_information(lights, electrons, noise, background_electrons)
    scale = np.sqrt(np.diag(j))
    j /= scale * scale[:, None]
    others = j[3:, 3:] + SINGULAR * np.eye(len(j) - 3)
    left = j[:3, :3] - j[:3, 3:] @ cho_solve(cho_factor(others, lower=True), j[3:, :3])
    value, vector = np.linalg.eigh(left)
    value[value < 1e3 * SINGULAR] = 0.0  # rounding
    return (vector * value) @ vector.T * (scale[:3] * scale[:3, None])


def _with_sensor_for(camera: PlenopticCamera, half_mm: float, scale: float, blur_mm: float) -> PlenopticCamera:
    """The same camera with a sensor that sees |x|, |y| <= half_mm; the lattice stays where it is on the pixels."""
    sensor = camera.sensor
    reach = (half_mm * scale + blur_mm + 2.0 * camera.lattice.pitch_mm) * (1.0 + camera.image_scale)
    side = 2 * ceil(reach / sensor.pixel_pitch_mm)
    return replace(camera, sensor=replace(sensor, columns=side + sensor.columns % 2, rows=side + sensor.rows % 2))
