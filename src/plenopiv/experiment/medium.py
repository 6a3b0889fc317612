"""The table [medium]: a fluid behind a plane window between camera and volume."""

from __future__ import annotations

from math import cos, radians, tan
from typing import Annotated

from pydantic import Field

from plenopiv.cameras.medium import Medium
from plenopiv.experiment.tables import NotNegative, PositiveFloat, Table
from plenopiv.volume import Limits

Index = Annotated[float, Field(ge=1, le=4)]
Tilt = Annotated[float, Field(ge=-45, le=45)]


class MediumTable(Table):
    """``[medium]``, in the camera's frame: z = 0 is the plane in focus, in the fluid. See ``cameras.medium.Medium``.

    ``fluid_mm`` from z = 0 to the window's inner face, on the axis; ``window_mm`` across the window, which is turned by
    ``window_tilt_deg`` right-handed about x, then about y, about the point where the axis meets its inner face.
    """

    refractive_index: Index
    fluid_mm: PositiveFloat
    window_mm: NotNegative = Medium.window_mm
    window_refractive_index: Index = Medium.window_refractive_index
    window_tilt_deg: Annotated[tuple[Tilt, Tilt], Field(strict=False)] = Medium.window_tilt_deg

    def medium(self) -> Medium:
        """The same as rays take it."""
        return Medium(**self.model_dump())

    def window_z_mm(self, x_mm: float, y_mm: float) -> float:
        """Where the window's inner face is."""
        about_x, about_y = map(radians, self.window_tilt_deg)
        return self.fluid_mm - x_mm * tan(about_y) + y_mm * tan(about_x) / cos(about_y)


def medium_contradictions(table: MediumTable, object_distance_mm: float, volume_mm: Limits | None) -> list[str]:
    """Reasons why this fluid cannot be before this camera, a line each, its key first. ``volume_mm``: in the camera's
    frame, None where it is not known."""
    lines, way = [], table.medium().optical_way_mm
    if way >= object_distance_mm:
        lines.append(
            f"medium.fluid_mm: fluid and window take {way:.4g} mm (fluid_mm/refractive_index + "
            f"window_mm/window_refractive_index) of the {object_distance_mm:.4g} mm from the focal plane to the lens, "
            "and leave no air"
        )
    if volume_mm is not None:
        (x0, x1), (y0, y1), (_, far) = volume_mm
        window = min(table.window_z_mm(x, y) for x in (x0, x1) for y in (y0, y1))
        if window <= far:
            lines.append(
                f"medium.fluid_mm: {table.fluid_mm:g} mm of fluid between z = 0 and the window end within the volume, "
                f"which reaches to z = {far:g} mm; it is the distance from the focal plane to the window's inner face"
            )
    return lines
