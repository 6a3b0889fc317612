"""Flows from files: a user's solver, or a measured field, as the truth of a simulation; and the jet that is shipped.

netCDF4 (``.nc``) with u, v, w on x, y, z, and VTK images (``.vti``, legacy ``.vtk``). The file's axes are those of the
object frame: z grows toward the camera. ``at_mm`` moves the field under the camera, it does not turn it.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import as_file, files
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.gridded import OUTSIDE, GriddedVelocity, Outside

Vector = tuple[float, float, float]
# How files write units, without blanks, in mm and m/s.
LENGTHS = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "meter": 1e3, "metre": 1e3}
LENGTHS |= {"um": 1e-3, "µm": 1e-3, "micrometer": 1e-3, "micron": 1e-3}
SPEEDS = {"m/s": 1.0, "ms-1": 1.0, "ms^-1": 1.0, "mm/s": 1e-3, "mms-1": 1e-3, "mms^-1": 1e-3}
SPEEDS |= {"cm/s": 1e-2, "cms-1": 1e-2, "cms^-1": 1e-2}
UNEVEN = 1e-3  # of the spacing: what rounding of coordinates to float32 may cost


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
        _ = self.field  # a wrong file is told now, not at the first particle

    @cached_property
    def field(self) -> GriddedVelocity:
        """The file's content, in its own frame."""
        from plenopiv.simulation.vtk_image import read_vtk_image

        path = Path(self.path)
        if not path.is_file():
            raise PlenoPIVError(f"flow: {path}: no such file")
        if path.suffix in (".vti", ".vtk"):
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
        return read_netcdf(path).in_mm_and_m_s(outside="periodic")


@dataclass(frozen=True, eq=False)
class FileGrid:
    """What a file holds, in its own units.

    ``velocity``: (z, y, x, 3). ``first`` and ``spacing`` along x, y, z. ``length_unit`` and ``velocity_unit``: what the
    file states for (x, y, z) and (u, v, w), None where it does not.
    """

    path: Path
    velocity: NDArray
    first: Vector
    spacing: Vector
    length_unit: tuple[str | None, ...] = (None, None, None)
    velocity_unit: tuple[str | None, ...] = (None, None, None)

    def in_mm_and_m_s(
        self, length_unit: str | None = None, velocity_unit: str | None = None, outside: Outside = "error"
    ) -> GriddedVelocity:
        """The same in mm and m/s; the units given serve where the file states none."""
        mm = [_factor(self.path, "length_unit", axis, stated, length_unit, LENGTHS)
              for axis, stated in zip("xyz", self.length_unit, strict=True)]  # fmt: skip
        m_s = [_factor(self.path, "velocity_unit", name, stated, velocity_unit, SPEEDS)
               for name, stated in zip("uvw", self.velocity_unit, strict=True)]  # fmt: skip
        first, spacing = (tuple(a * b for a, b in zip(v, mm, strict=True)) for v in (self.first, self.spacing))
        return GriddedVelocity(self.velocity * m_s, first, spacing, outside, str(self.path))  # type: ignore[arg-type]


def _factor(path: Path, key: str, name: str, stated: str | None, given: str | None, known: dict[str, float]) -> float:
    """What one of the file's units is in ours."""
    if stated and given and known.get(_plain(stated)) != known.get(_plain(given)):
        raise PlenoPIVError(f"flow: {path}: {name} is in '{stated}' there, but {key} = '{given}'; leave {key} out")
    unit = stated or given
    usual = [u for u in known if "/" in u or len(u) < 3]
    if unit is None:
        raise PlenoPIVError(f"flow: {path}: states no units for {name}; give {key}, one of {', '.join(usual)}")
    if _plain(unit) not in known:
        raise PlenoPIVError(f"flow: {path}: {name} is in '{unit}', which is not known; use one of {', '.join(usual)}")
    return known[_plain(unit)]


def _plain(unit: str) -> str:
    """A unit without blanks and dots; "m s-1", "m.s**-1" and "ms^-1" are one."""
    joined = "".join(unit.replace("**", "^").replace("·", " ").replace(".", " ").split())
    return joined[:-1] if joined.endswith(("meters", "metres", "microns")) else joined


def read_netcdf(path: Path, variables: tuple[str, ...] = (), time: int | None = None) -> FileGrid:
    """Velocities on a regular grid from netCDF4: three variables on dimensions x, y, z, in any order.

    ``variables``: the names of u, v, w. ``time``: which one of several along a dimension ``time``.

    Raises:
        PlenoPIVError: no netCDF4, other dimensions, missing variables, uneven coordinates.
    """
    import xarray

    try:
        with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
            loaded = dataset.load()
    except Exception as error:  # HDF5, netCDF and decoding each fail in their own way
        reason = " ".join(str(error).split())[:100]
        raise PlenoPIVError(f"flow: {path}: is no netCDF4 file or is damaged ({reason})") from None
    names = variables or ("u", "v", "w")
    if len(names) != 3:
        raise PlenoPIVError(f"flow: {path}: variables = {list(names)}; give the three names of u, v, w")
    for name in names:
        if name not in loaded:
            raise PlenoPIVError(f"flow: {path}: {missing_variable(name, [str(v) for v in loaded.data_vars])}")
    components = []
    for name in names:
        component = _at_time(path, loaded[name], time)
        if sorted(map(str, component.dims)) != ["x", "y", "z"]:
            raise PlenoPIVError(f"flow: {path}: {name} has dimensions {tuple(component.dims)}, wanted z, y, x")
        for axis in "xyz":
            if axis not in component.coords:
                raise PlenoPIVError(f"flow: {path}: has no coordinate {axis}; write one with its units")
        components.append(component.transpose("z", "y", "x").sortby(["z", "y", "x"]))
    one = components[0]
    first, spacing = zip(*(_even(path, axis, one[axis].values) for axis in "xyz"), strict=True)
    return FileGrid(
        path,
        np.stack([c.values for c in components], -1),
        first,
        spacing,
        tuple(_stated(one[axis]) for axis in "xyz"),
        tuple(_stated(c) for c in components),
    )


def _stated(variable) -> str | None:
    """A variable's units, None where it has none."""
    return str(variable.attrs["units"]) if "units" in variable.attrs else None


def _at_time(path: Path, component, time: int | None):
    """One time of a variable that has several."""
    if "time" not in component.dims:
        return component
    count = component.sizes["time"]
    if time is None and count > 1:
        raise PlenoPIVError(f"flow: {path}: holds {count} times; give time, 0 for the first")
    if not 0 <= (time or 0) < count:
        raise PlenoPIVError(f"flow: {path}: time = {time}, it holds 0 to {count - 1}")
    return component.isel(time=time or 0)


def _even(path: Path, axis: str, values: NDArray) -> tuple[float, float]:
    """First value and spacing of a coordinate whose values rise evenly."""
    values = np.asarray(values, float)
    if len(values) < 2:
        raise PlenoPIVError(f"flow: {path}: one point along {axis}; a volume is needed")
    spacing = float(values[-1] - values[0]) / (len(values) - 1)
    off = float(np.abs(values - values[0] - spacing * np.arange(len(values))).max())
    if not off <= UNEVEN * spacing:
        raise PlenoPIVError(
            f"flow: {path}: {axis} is not evenly spaced (off by {off:.3g} at a mean spacing of {spacing:.3g}); "
            "interpolate it onto a regular grid first"
        )
    return float(values[0]), spacing


def missing_variable(name: str, there: list[str]) -> str:
    """What to say of a variable that is missing."""
    close = difflib.get_close_matches(name, there, 1, 0.6)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return f"has no variable '{name}'; {hint}it holds {', '.join(there) or 'none'}; name yours with variables"


def _check_place(at_mm: Vector, speed: float) -> None:
    if len(at_mm) != 3 or not all(isfinite(v) for v in at_mm):
        raise PlenoPIVError(f"flow: at_mm = {list(at_mm)}; give x, y, z in mm")
    if not isfinite(speed):
        raise PlenoPIVError(f"flow: speed = {speed}; give a finite factor on the velocities")
