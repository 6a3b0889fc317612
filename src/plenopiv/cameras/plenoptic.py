"""An unfocused plenoptic camera: thin main lens, microlens array, sensor one microlens focal length behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv import optics
from plenopiv.errors import PlenoPIVError, check_positive
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor


@dataclass(frozen=True)
class MainLens:
    """Thin lens. Lengths in mm; magnification M < 0 fixes the conjugate distances. Raises PlenoPIVError for others."""

    focal_length_mm: float
    aperture_mm: float
    magnification: float

    def __post_init__(self) -> None:
        check_positive("main lens", focal_length_mm=self.focal_length_mm, aperture_mm=self.aperture_mm)
        if not -inf < self.magnification < 0:
            raise PlenoPIVError(
                f"main lens: magnification = {self.magnification}, give a negative number, as a real image is inverted"
            )

    @property
    def object_distance_mm(self) -> float:
        """S_o: from the focal plane (z = 0) to the main lens."""
        return optics.conjugate_distances(self.focal_length_mm, self.magnification)[0]

    @property
    def image_distance_mm(self) -> float:
        """S_i: from the main lens to the microlens plane."""
        return optics.conjugate_distances(self.focal_length_mm, self.magnification)[1]


@dataclass(frozen=True)
class LensRim:
    """The rim of the main lens, where it clips oblique light: through the microlens at S it is seen, on the main lens,
    as a disc of ``radius_mm`` about ``slip * S + start_mm``. Lengths in mm, along (x, y)."""

    radius_mm: float
    slip: float
    start_mm: tuple[float, float]


@dataclass(frozen=True)
class PlenopticCamera:
    """Everything that fixes where the light of a point goes.

    ``lattice`` is the lattice of the *microlenses* (not of their images, which are ``image_pitch`` apart). ``rim``:
    what else than its aperture limits the main lens, None where nothing does. ``blur_mm``: of a main lens that is not
    sharp, the standard deviation along each axis of the Gaussian by which it displaces rays on the microlens plane,
    their direction kept.

    Raises PlenoPIVError for a focal length that is not positive and a negative blur.
    """

    main_lens: MainLens
    lattice: Lattice
    microlens_focal_length_mm: float
    sensor: Sensor
    rim: LensRim | None = None
    blur_mm: float = 0.0

    def __post_init__(self) -> None:
        check_positive("microlens array", focal_length_mm=self.microlens_focal_length_mm)
        if not 0 <= self.blur_mm < inf:
            raise PlenoPIVError(f"main lens: blur_mm = {self.blur_mm}, give 0 or a positive number")

    def __repr__(self) -> str:
        lens, sensor = self.main_lens, self.sensor
        return (
            f"<PlenopticCamera f = {lens.focal_length_mm:g} mm, aperture {lens.aperture_mm:.4g} mm,"
            f" M = {lens.magnification:g}; {self.lattice!r}, f_l = {self.microlens_focal_length_mm:g} mm;"
            f" {sensor.columns} x {sensor.rows} px of {sensor.pixel_pitch_mm:g} mm>"
        )

    @property
    def image_scale(self) -> float:
        """e = f_l / S_i: a main-lens coordinate u is e u wide under a microlens."""
        return self.microlens_focal_length_mm / self.main_lens.image_distance_mm

    @property
    def image_pitch_px(self) -> float:
        """Pitch of the micro-images in pixels: p_l (1 + f_l/S_i) / p_p, not p_l / p_p."""
        return self.lattice.pitch_mm * (1.0 + self.image_scale) / self.sensor.pixel_pitch_mm

    @property
    def portion_mm(self) -> float:
        """Width on the main lens of what one pixel sees: the pixel pitch over e."""
        return self.sensor.pixel_pitch_mm / self.image_scale

    @property
    def aperture_radius_px(self) -> float:
        """Radius in pixels of the main lens' image under a microlens."""
        return 0.5 * self.main_lens.aperture_mm * self.image_scale / self.sensor.pixel_pitch_mm

    @property
    def pixels_per_microlens(self) -> float:
        """PMR: microlens pitch over pixel pitch."""
        return self.lattice.pitch_mm / self.sensor.pixel_pitch_mm

    @property
    def microlenses(self) -> float:
        """How many micro-images fit on the sensor, by area."""
        sensor = self.sensor
        area = sensor.columns * sensor.rows * sensor.pixel_pitch_mm**2
        return area / (self.lattice.cell_area_mm2 * (1.0 + self.image_scale) ** 2)

    @property
    def matched_aperture_mm(self) -> float:
        """The aperture whose images just touch: P_m = S_i p_l / f_l (f-number matching)."""
        return self.main_lens.image_distance_mm * self.lattice.pitch_mm / self.microlens_focal_length_mm

    def spread(self, z_mm: ArrayLike) -> NDArray:
        """A(z): see ``optics.spread``."""
        lens = self.main_lens
        return optics.spread(z_mm, lens.object_distance_mm, lens.image_distance_mm, lens.focal_length_mm)

    def scale(self, z_mm: ArrayLike) -> NDArray:
        """B(z): see ``optics.scale``."""
        return optics.scale(z_mm, self.main_lens.object_distance_mm, self.main_lens.image_distance_mm)

    def dead_zone_mm(self) -> tuple[float, float]:
        """The z interval around focus in which a point centred on a microlens has no depth.

        There the blur |A| P_m is below one pitch: z = +-p_l S_o / (P_m |M| +- p_l), about +-f_l/M^2 when matched.
        """
        m, p, aperture = abs(self.main_lens.magnification), self.lattice.pitch_mm, self.main_lens.aperture_mm
        so = self.main_lens.object_distance_mm
        return -p * so / (aperture * m - p), p * so / (aperture * m + p)

    def dead_zones(self, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distances of ``z_mm`` from focus, in its shape, over that at which the dead zone ends on their side."""
        below, above = self.dead_zone_mm()
        return np.abs(z_mm) / np.where(z_mm < 0, -below, above)

    def with_lattice(self, lattice: Lattice) -> PlenopticCamera:
        """The same camera with a calibrated lattice."""
        return replace(self, lattice=lattice)
