"""Flows from files: a user's solver, or a measured field, as the truth of a simulation; and the jet that is shipped.

netCDF4 (``.nc``) with u, v, w on x, y, z, and VTK images (``.vti``, legacy ``.vtk``). The file's axes are those of the
object frame: z grows toward the camera. ``at_mm`` moves the field under the camera, it does not turn it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import as_file, files
from numbers import Real
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.file_grid import Vector
from plenopiv.simulation.gridded import OUTSIDE, GriddedVelocity, Outside
from plenopiv.simulation.netcdf_grid import read_netcdf
from plenopiv.simulation.vtk_image import read_vtk_image

LARGEST = 1e9  # mm, or times


@dataclass(frozen=True)
class FlowFile:
    """Velocities of a file, between its points by splines of degree five (``simulation.gridded``).

    ``at_mm`` is the point of the file's frame that lies at the origin of the object frame: the camera looks there.
    ``speed`` multiplies all velocities. ``outside`` as in ``GriddedVelocity``. ``variables``: the names of u, v, w, or
    one vector's; by default u, v, w, else the file's only vector. ``length_unit`` and ``velocity_unit`` are for
    files that state none, as VTK files cannot. ``time``: which one, counted from 0, of a file that holds several.

    Raises:
        PlenoPIVError: the file is missing, damaged or of another kind, has no such variables, no units, uneven spacing,
            values that are not finite; when called, points outside.
    """

    path: str
    at_mm: Vector = (0.0, 0.0, 0.0)
    speed: float = 1.0
    outside: Outside = "error"
    variables: tuple[str, ...] = ()
    length_unit: str | None = None
    velocity_unit: str | None = None
    time: int | None = None

    def __post_init__(self) -> None:
        _check_place(self.at_mm, self.speed)
        if self.outside not in OUTSIDE:
            raise PlenoPIVError(f"flow: outside = {self.outside!r}; give one of {', '.join(OUTSIDE)}")
        if isinstance(self.variables, str):
            object.__setattr__(self, "variables", (self.variables,))
        if not isinstance(self.variables, tuple) or not all(isinstance(name, str) for name in self.variables):
            raise PlenoPIVError(f"flow: variables = {self.variables!r:.60}; give names of variables")
        for key in ("length_unit", "velocity_unit"):
            unit = getattr(self, key)
            if unit is not None and not isinstance(unit, str):
                raise PlenoPIVError(f'flow: {key} = {unit!r:.60}; give a unit as text, such as "mm" or "m/s"')
        if self.time is not None and (isinstance(self.time, bool) or not isinstance(self.time, int)):
            raise PlenoPIVError(f"flow: time = {self.time!r:.60}; give its number, 0 for the first")
        if not isinstance(self.path, str | Path) or "\0" in str(self.path):
            raise PlenoPIVError(f"flow: path = {self.path!r:.60} is no file name")
        _ = self.field  # a wrong file raises now, not at the first particle

    @cached_property
    def field(self) -> GriddedVelocity:
        """The file's content, in its own frame."""
        path = Path(self.path)
        if not path.is_file():
            raise PlenoPIVError(f"flow: {path}: no such file")
        if path.suffix in (".vti", ".vtk"):
            if self.time:
                raise PlenoPIVError(f"flow: {path}: a VTK image holds one time; leave out time = {self.time}")
            grid = read_vtk_image(path, self.variables)
        elif path.suffix in (".nc", ".nc4", ".h5", ".cdf"):
            grid = read_netcdf(path, self.variables, self.time)
        else:
            raise PlenoPIVError(f"flow: {path}: read are netCDF4 (.nc) and VTK images (.vti, .vtk)")
        return grid.in_mm_and_m_s(self.length_unit, self.velocity_unit, self.outside)

    def __call__(self, points_mm: NDArray) -> NDArray[np.float64]:
        """Velocity (n, 3) in m/s at (n, 3) mm of the object frame."""
        return self.speed * self.field(points_mm + np.asarray(self.at_mm, float))


@dataclass(frozen=True)
class Jet:
    """A temporal round jet along x, D = 6 mm, Re = 2500, U = 0.417 m/s in water, as ``docs/jet.md`` describes it.

    Its axis is y = z = 0; the shear layer rolls up about r = 3 mm. The field is periodic, every 36 mm along x and every
    24 mm along y and z. ``at_mm`` is the point of the jet that lies at the origin of the object frame: (0, 3, 0) has a
    camera look at the shear layer. ``speed`` multiplies all velocities (and so Re, were it another jet).
    """

    at_mm: Vector = (0.0, 0.0, 0.0)
    speed: float = 1.0

    def __post_init__(self) -> None:
        _check_place(self.at_mm, self.speed)

    def __call__(self, points_mm: NDArray) -> NDArray[np.float64]:
        """Velocity (n, 3) in m/s at (n, 3) mm of the object frame."""
        return self.speed * _jet()(points_mm + np.asarray(self.at_mm, float))


@cache
def _jet() -> GriddedVelocity:
    """The snapshot that is shipped, read once."""
    with as_file(files("plenopiv.simulation") / "jet.nc") as path:
        return read_netcdf(path, ours=True).in_mm_and_m_s(outside="periodic")


def _check_place(at_mm: Vector, speed: float) -> None:
    if not isinstance(at_mm, tuple) or len(at_mm) != 3 or not all(map(in_range, at_mm)):
        raise PlenoPIVError(f"flow: at_mm = {at_mm!r:.60}; give x, y, z in mm")
    if not in_range(speed):
        raise PlenoPIVError(f"flow: speed = {speed!r:.60}; give a finite factor on the velocities")


def in_range(value: object) -> bool:
    """Whether it is a number that a length, or a factor, may be."""
    return isinstance(value, Real) and not isinstance(value, bool) and abs(float(value)) <= LARGEST
