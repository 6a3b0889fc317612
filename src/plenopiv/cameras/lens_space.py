"""From a camera in its laboratory to the thin lens in air that the projection knows, and a map between both.

All rays of a point of the laboratory are traced to the microlens plane. The point of lens space whose rays,
s = A(z) u + B(z) x, come nearest to them is its image there (least squares over the aperture). What is left differs
from view to view, as spherical aberration does. It belongs to the ray, wherever on it the point lies: so what all
points leave is taken off their rays, and their images are sought anew, until both agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.ray_model import RayModel, on_disc
from plenopiv.cameras.space_map import SpaceMap, ViewShift
from plenopiv.volume import Limits

RAYS = 61  # over the aperture
EVERY = 3  # of the rays is enough for what differs between views
POINTS = (9, 9, 13)  # along x, y and z, where a map is fitted
STEPS, STILL = 6, 0.8  # in which images and what is left come to agree; of the last step's, more is no progress
LEAST_LEFT = 1e-3  # of a pitch: rays that miss those of a thin lens by less are taken for them
MARGIN = 0.05  # of the volume's sides, by which the map reaches beyond it


@dataclass(frozen=True)
class Images:
    """Images of points in lens space. ``place_mm`` (n, 3); ``left_mm`` (n, rays, 2): what the rays miss those of a thin
    lens by, on the microlens plane; ``s_mm``, ``u_mm`` (n, rays, 2): where the rays fall, and the views' places."""

    place_mm: NDArray[np.float64]
    left_mm: NDArray[np.float64]
    s_mm: NDArray[np.float64]
    u_mm: NDArray[np.float64]


def images_of(
    points_mm: ArrayLike, model: RayModel, camera: PlenopticCamera, rays: int = RAYS, aperture_mm: float | None = None
) -> Images:
    """The images of ``points_mm`` (n, 3) of the laboratory in the lens space of ``camera``, over its aperture, or over
    one of ``aperture_mm``."""
    aperture = camera.main_lens.aperture_mm if aperture_mm is None else aperture_mm
    radius = aperture / 2 * model.image_distance_mm / model.reference_mm / model.view_scale
    return _nearest(camera, *model.trace(points_mm, on_disc(radius, rays)))


def _nearest(camera: PlenopticCamera, s: NDArray, u: NDArray, beside: NDArray | float = 0.0) -> Images:
    """The images whose rays come nearest to those at ``s`` and ``u`` (n, rays, 2), of which ``beside`` (n, rays, 2) is
    known not to be a thin lens'."""
    seen, s = s, s - beside
    s_mean, u_mean = s.mean(1, keepdims=True), u.mean(1, keepdims=True)
    spread = ((s - s_mean) * (u - u_mean)).sum((1, 2)) / ((u - u_mean) ** 2).sum((1, 2))
    centre = s_mean - spread[:, None, None] * u_mean
    left = s - spread[:, None, None] * u - centre
    return Images(lens_place(camera, spread, centre[:, 0]), left, seen, u)


def lens_place(camera: PlenopticCamera, spread: NDArray, centre_mm: NDArray) -> NDArray[np.float64]:
    """The points (n, 3) of lens space whose light falls at s = A u + c; A = ``spread`` (n,), c = ``centre_mm``
    (n, 2)."""
    lens = camera.main_lens
    distance = lens.image_distance_mm / (spread - 1 + lens.image_distance_mm / lens.focal_length_mm)
    across = -centre_mm * (distance / lens.image_distance_mm)[:, None]
    return np.column_stack([across, lens.object_distance_mm - distance])


def behind_window(camera: PlenopticCamera, medium: Medium) -> RayModel:
    """The rays of a thin lens behind fluid and window, the plane z = 0 of the fluid in focus on the axis.

    Raises:
        PlenoPIVError: fluid and window are optically longer than the object distance.
    """
    lens, sensor = camera.main_lens, camera.sensor
    gap, corner = (
        medium.gap_mm(lens.object_distance_mm),
        0.5 * sensor.pixel_pitch_mm * hypot(sensor.columns, sensor.rows),
    )
    return RayModel(lens.focal_length_mm, lens.image_distance_mm, gap, medium, lens.image_distance_mm, corner)


def space_map(model: RayModel, camera: PlenopticCamera, laboratory: Limits) -> SpaceMap:
    """The map between a volume of the laboratory, outer faces ``laboratory``, and the lens space of ``camera``."""
    points = sample(laboratory)
    images = images_of(points, model, camera)
    least, beside, left = LEAST_LEFT * camera.lattice.pitch_mm, np.zeros_like(images.s_mm), None
    half = 0.5 * camera.sensor.pixel_pitch_mm * np.array([camera.sensor.columns, camera.sensor.rows])
    on_sensor = (np.abs(images.s_mm) < half + camera.lattice.pitch_mm).all(-1)
    before = np.inf
    for _ in range(STEPS):
        largest = np.abs(images.left_mm[on_sensor]).max(initial=0.0)
        if largest < least or largest > STILL * before:
            break
        before = largest
        u, s, all_left = (v[on_sensor][::EVERY] for v in (images.u_mm, images.s_mm, images.left_mm + beside))
        left = ViewShift.fitted(u, s, all_left)
        beside = left(images.u_mm.reshape(-1, 2), images.s_mm.reshape(-1, 2)).reshape(beside.shape)
        images = _nearest(camera, images.s_mm, images.u_mm, beside)
    along_s, along_t = (tilt / model.corner_mm for tilt in model.gap_tilt)
    return replace(SpaceMap.fitted(points, images.place_mm), left=left, growth=(along_s, along_t))


def sample(laboratory: Limits) -> NDArray[np.float64]:
    """Points (n, 3) all over a volume and a little beyond."""
    axes = [
        np.linspace(lo - MARGIN * (hi - lo), hi + MARGIN * (hi - lo), n)
        for (lo, hi), n in zip(laboratory, POINTS, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
