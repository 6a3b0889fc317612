"""A camera as it stands in a laboratory: stop, rim, distortion and array of a plenoptic camera before a tank.

The frame is that of ``PlenopticCamera``: z = 0 the plane in focus on the axis, +z toward the camera, in mm. The lens is
thin and otherwise ideal; what it does to a ray is written in ``real_kernels``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.real_kernels import Constants


@dataclass(frozen=True)
class Pose:
    """How the laboratory's frame lies in the camera's: turned right-handed by ``tilt_deg`` about x, then about y, then
    by ``turn_deg`` about z, its origin at ``origin_mm``."""

    turn_deg: float = 0.0
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3): in its columns the laboratory's axes in the camera's frame."""
        return _turned(*self.tilt_deg, self.turn_deg)

    def to_camera(self, laboratory_mm: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of the laboratory in the camera's frame."""
        return np.asarray(laboratory_mm, float) @ self.axes.T + self.origin_mm

    def to_laboratory(self, camera_mm: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of the camera's frame in the laboratory's."""
        return (np.asarray(camera_mm, float) - self.origin_mm) @ self.axes


@dataclass(frozen=True)
class RealCamera:
    """The parameters of a real camera and of what stands before it. Lengths in mm.

    ``stop_mm``: the aperture stop in front of the lens (behind it: negative), ``stop_radius_mm`` its radius;
    ``rim_radius_mm``: that of the lens itself, None for one that clips nothing. ``distortion``: by what share the image
    is further off the axis in the sensor's corner; it grows with the square of the distance. ``gap_tilt``: by what
    share of the microlenses' focal length the gap behind them grows over the length of the sensor's diagonal, along
    ``gap_tilt_direction_deg`` in (s, t). ``aspect``: by what share rows of microlenses are further apart than their
    pitch would have it; ``array_distortion``: by what share a microlens in the sensor's corner is further off the axis
    than the lattice would have it, as the square of the distance. ``blur_mm``: as of ``PlenopticCamera``, for
    particles; targets are imaged sharp. ``medium``: in the camera's frame; its window is
    turned about x, then about y, about the point where the axis meets its inner face: +1 degree about y brings its side
    at +x nearer to z = 0.
    """

    focal_length_mm: float
    image_distance_mm: float
    stop_radius_mm: float
    lattice: Lattice
    microlens_focal_length_mm: float
    sensor: Sensor
    stop_mm: float = 0.0
    rim_radius_mm: float | None = None
    distortion: float = 0.0
    gap_tilt: float = 0.0
    gap_tilt_direction_deg: float = 0.0
    aspect: float = 0.0
    array_distortion: float = 0.0
    blur_mm: float = 0.0
    medium: Medium | None = None
    pose: Pose = Pose()

    def __post_init__(self) -> None:
        f = self.focal_length_mm
        if not 0 < f < self.image_distance_mm:
            raise PlenoPIVError(f"camera: focal length {f:g} mm is not shorter than the image distance")
        if self.lattice.map is not None:
            raise PlenoPIVError(
                f"camera: lattice.map, of degree {self.lattice.map.degree}, is not simulated; use a regular lattice "
                "with aspect and array_distortion"
            )
        if self.stop_radius_mm <= 0 or (self.rim_radius_mm is not None and self.rim_radius_mm <= 0):
            raise PlenoPIVError("camera: radii of stop and rim must be positive")
        if -self.stop_mm >= f or self._pupil_way_mm <= 0:
            raise PlenoPIVError(f"camera: a stop {-self.stop_mm:g} mm behind the lens images nothing")
        bent = max(abs(self.distortion), abs(self.array_distortion))
        if bent > 0.2 or abs(self.gap_tilt) > 1 or abs(self.aspect) > 0.5:
            raise PlenoPIVError("camera: distortion, gap_tilt and aspect are shares; these are too large for a camera")
        if self.medium is not None:
            n, glass = self.medium.refractive_index, self.medium.window_refractive_index
            if min(n, glass) < 1 or self.medium.fluid_mm <= 0 or self.medium.window_mm < 0:
                raise PlenoPIVError(f"medium: {self.medium} is no fluid behind a window")
        if self.air_mm <= max(self.stop_mm, 0.0):
            optical = self.object_distance_mm - self.air_mm
            raise PlenoPIVError(
                f"medium: fluid and window take {optical:.6g} mm of the {self.object_distance_mm:.6g} mm between focus "
                f"and lens, and leave no air in front of the stop; reduce fluid_mm or window_mm"
            )

    @classmethod
    def of(cls, camera: PlenopticCamera, **real: object) -> RealCamera:
        """The camera with what its data sheet does not say; its aperture is that of the entrance pupil.

        Raises PlenoPIVError for a camera whose rim is given as its microlenses see it.
        """
        if camera.rim is not None:
            raise PlenoPIVError(
                f"camera: rim = {camera.rim} says nothing of where the stop is; use replace(camera, rim=None), and "
                "stop_mm and rim_radius_mm"
            )
        lens = camera.main_lens
        behind = max(-float(real.get("stop_mm", 0.0)), 0.0)  # type: ignore[arg-type]
        return cls(
            focal_length_mm=lens.focal_length_mm,
            image_distance_mm=lens.image_distance_mm,
            stop_radius_mm=0.5 * lens.aperture_mm * (1.0 - behind / lens.focal_length_mm),
            lattice=camera.lattice,
            microlens_focal_length_mm=camera.microlens_focal_length_mm,
            sensor=camera.sensor,
            blur_mm=camera.blur_mm,
            **real,  # type: ignore[arg-type]
        )

    @property
    def object_distance_mm(self) -> float:
        """S_o, the distance of focus in air."""
        return self.focal_length_mm * self.image_distance_mm / (self.image_distance_mm - self.focal_length_mm)

    @property
    def air_mm(self) -> float:
        """Air between window (without a medium: the plane in focus) and lens, on the axis, such that z = 0 is in focus:
        to first order fluid and window bring a point nearer by their refractive indices."""
        if self.medium is None:
            return self.object_distance_mm
        optical = self.medium.fluid_mm / self.medium.refractive_index
        return self.object_distance_mm - optical - self._window_mm / self.medium.window_refractive_index

    @property
    def _normal(self) -> NDArray[np.float64]:
        """Unit normal of the window, toward the camera."""
        return np.array([0.0, 0.0, 1.0]) if self.medium is None else _turned(*self.medium.window_tilt_deg, 0.0)[:, 2]

    @property
    def _window_mm(self) -> float:
        """Of the window, along the axis."""
        return 0.0 if self.medium is None else self.medium.window_mm / float(self._normal[2])

    @property
    def lens_z_mm(self) -> float:
        """Where the lens stands."""
        medium = self.medium
        return self.air_mm + (0.0 if medium is None else medium.fluid_mm + self._window_mm)

    @property
    def _squeeze(self) -> float:
        """1 - stop/f: what a stop in front of the lens is divided by to be its exit pupil."""
        return 1.0 - abs(self.stop_mm) / self.focal_length_mm

    @property
    def _pupil_way_mm(self) -> float:
        """Distance from exit pupil to microlenses for a pupil of the stop's size."""
        if self.stop_mm < 0:
            return self.image_distance_mm + self.stop_mm
        return self.image_distance_mm * self._squeeze + self.stop_mm

    @property
    def exit_pupil_mm(self) -> float:
        """From exit pupil to microlenses; infinite in a telecentric camera, whose stop is a focal length in front."""
        if self.stop_mm < 0:
            return self._pupil_way_mm
        return self._pupil_way_mm / self._squeeze if self._squeeze else inf

    @property
    def entrance_pupil_mm(self) -> tuple[float, float]:
        """How far in front of the lens (behind it: negative) the entrance pupil lies, and its radius."""
        if self.stop_mm < 0:
            return self.stop_mm / self._squeeze, self.stop_radius_mm / self._squeeze
        return self.stop_mm, self.stop_radius_mm

    @property
    def micro_image_radius_mm(self) -> float:
        """Radius of the stop's image under a microlens."""
        return self.microlens_focal_length_mm * self.stop_radius_mm / self._pupil_way_mm

    def in_front_mm(self, position_mm: ArrayLike) -> NDArray[np.float64]:
        """How far points (..., 3) of the camera's frame are in front of the window, or of the stop where there is no
        window; negative behind it."""
        position = np.asarray(position_mm, float)
        if self.medium is None:
            return self.lens_z_mm - max(self.entrance_pupil_mm[0], 0.0) - position[..., 2]
        return -(position - (0.0, 0.0, self.medium.fluid_mm)) @ self._normal

    @property
    def constants(self) -> Constants:
        """All of it as kernels take it."""
        sensor, lattice = self.sensor, self.lattice
        diagonal = hypot(sensor.columns, sensor.rows) * sensor.pixel_pitch_mm
        entrance, radius = self.entrance_pupil_mm
        medium = self.medium or Medium()
        nx, ny, nz = self._normal.tolist()
        tilt, way = self.gap_tilt / diagonal, radians(self.gap_tilt_direction_deg)
        return Constants(
            focal=self.focal_length_mm, image=self.image_distance_mm, entrance=entrance, radius=radius,
            rim=inf if self.rim_radius_mm is None else self.rim_radius_mm,
            bend=self.distortion / (diagonal / 2) ** 2, to_exit=1.0 / self.exit_pupil_mm, lens_z=self.lens_z_mm,
            refracts=self.medium is not None, n_fluid=medium.refractive_index, fluid=medium.fluid_mm,
            n_window=medium.window_refractive_index, window=medium.window_mm, nx=nx, ny=ny, nz=nz,
            gap=self.microlens_focal_length_mm, tilt_s=tilt * cos(way), tilt_t=tilt * sin(way),
            micro_radius=self.micro_image_radius_mm, hexagonal=lattice.kind == "hexagonal", pitch=lattice.pitch_mm,
            stretch=1.0 + self.aspect, turn_c=cos(lattice.rotation_rad), turn_s=sin(lattice.rotation_rad),
            offset_s=lattice.offset_mm[0], offset_t=lattice.offset_mm[1],
            array_bend=self.array_distortion / (diagonal / 2) ** 2,
            column0=sensor.axis[0], row0=sensor.axis[1], pixel=sensor.pixel_pitch_mm,
        )  # fmt: skip


def _turned(about_x_deg: float, about_y_deg: float, about_z_deg: float) -> NDArray[np.float64]:
    """Rotation (3, 3) about x, then y, then z, right-handed."""
    (a, b, c), (i, j, k) = (
        [f(radians(angle)) for angle in (about_x_deg, about_y_deg, about_z_deg)] for f in (cos, sin)
    )
    about_x = np.array([[1, 0, 0], [0, a, -i], [0, i, a]])
    about_y = np.array([[b, 0, j], [0, 1, 0], [-j, 0, b]])
    about_z = np.array([[c, -k, 0], [k, c, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
