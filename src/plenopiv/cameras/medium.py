"""What light crosses between the particles and the main lens: a fluid, a plane window, air."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, radians

from plenopiv.errors import PlenoPIVError

AIR = 1.0


@dataclass(frozen=True)
class Medium:
    """A fluid behind a plane window. Lengths in mm along the optical axis, angles in degrees.

    ``fluid_mm``: from z = 0 to the window's inner face. ``window_tilt_deg``: how far the window's normal is turned from
    the axis, about x and about y, right-handed.
    """

    refractive_index: float = AIR
    fluid_mm: float = 0.0
    window_mm: float = 0.0
    window_refractive_index: float = 1.5
    window_tilt_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def optical_way_mm(self) -> float:
        """The way in air that looks as long, near the axis: fluid and window each divided by its index."""
        return self.fluid_mm / self.refractive_index + self.window_along_axis_mm / self.window_refractive_index

    @property
    def window_along_axis_mm(self) -> float:
        """Thickness of the window where the axis crosses it."""
        return self.window_mm / cos(radians(hypot(*self.window_tilt_deg)))

    def gap_mm(self, object_distance_mm: float) -> float:
        """Air between window and main lens, if z = 0 is in focus at an object distance.

        Raises:
            PlenoPIVError: fluid and window take more than the object distance.
        """
        gap = object_distance_mm - self.optical_way_mm
        if gap <= 0:
            raise PlenoPIVError(
                f"medium: fluid and window are optically {self.optical_way_mm:.4g} mm long, but the plane in focus is "
                f"{object_distance_mm:.4g} mm from the main lens: correct [medium] or camera.main_lens"
            )
        return gap
