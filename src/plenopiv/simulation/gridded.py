"""A velocity known on a regular grid, as a callable: tensor-product B-splines.

Between its grid points a solver's field need not stay free of divergence. In a periodic box splines of mixed degree
keep it so exactly; elsewhere degree five leaves little. Decision 19 has the figures.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError

Outside = Literal["error", "zero", "periodic"]
OUTSIDE: tuple[str, ...] = get_args(Outside)
DEGREE = 5
ROUNDING = 1e-6  # of the spacing: points so near a face lie on it
FASTEST_M_S = 1e6
FEWEST_POINTS = 4  # along an axis; fewer than six take cubic splines there


@dataclass(frozen=True, eq=False)
class GriddedVelocity:
    """Velocity at (n, 3) points in mm, in m/s, from its values on a regular grid.

    ``velocity_m_s``: (z, y, x, 3), the components u, v, w last. ``first_mm`` and ``spacing_mm``: the first point of the
    grid and its spacing along x, y, z. ``outside``: what points off the grid get. "error" refuses them, "zero" is still
    fluid, "periodic" repeats the grid; its period is (number of points) x (spacing), so a file's last plane must not be
    its first one again. ``name`` is what messages call it.

    Not periodic: one interpolating spline of degree five, exact for polynomials of that degree up to the grid's faces.
    Periodic: see ``_mixed_splines``; free of divergence where the grid's Fourier series is.

    Raises:
        PlenoPIVError: fewer than four points along an axis, values that are not finite or beyond all velocities, a
            spacing that is not positive; when called, points outside.
    """

    velocity_m_s: NDArray = field(repr=False)
    first_mm: tuple[float, float, float]
    spacing_mm: tuple[float, float, float]
    outside: Outside = "error"
    name: str = "grid"
    _splines: tuple[Any, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = np.asarray(self.velocity_m_s, float)
        if values.ndim != 4 or values.shape[3] != 3:
            raise PlenoPIVError(f"flow: {self.name}: velocities of shape {values.shape}, wanted (z, y, x, 3)")
        for axis, points in zip("zyx", values.shape[:3], strict=True):
            if points < FEWEST_POINTS:
                raise PlenoPIVError(
                    f"flow: {self.name}: {points} points along {axis}; splines need {FEWEST_POINTS} or more"
                )
        if wrong := int((~np.isfinite(values)).any(-1).sum()):
            raise PlenoPIVError(
                f"flow: {self.name}: {wrong} of {values[..., 0].size} grid points are NaN or infinite; fill them or "
                "cut the file to where the flow is known"
            )
        if not (np.isfinite([*self.first_mm, *self.spacing_mm]).all() and min(self.spacing_mm) > 0):
            raise PlenoPIVError(
                f"flow: {self.name}: first point {list(self.first_mm)} mm, spacing {list(self.spacing_mm)} mm: "
                "spacings must be positive, all of them finite"
            )
        if (fastest := float(np.abs(values).max())) > FASTEST_M_S:
            raise PlenoPIVError(f"flow: {self.name}: {fastest:.3g} m/s is no velocity of a fluid; is its unit right?")
        splines = _mixed_splines(values) if self.outside == "periodic" else (_spline(values),)
        object.__setattr__(self, "_splines", splines)

    @property
    def limits_mm(self) -> tuple[tuple[float, float], ...]:
        """First and last point of the grid along x, y, z in mm."""
        points = self.velocity_m_s.shape[2::-1]
        return tuple((a, a + (n - 1) * h) for a, n, h in zip(self.first_mm, points, self.spacing_mm, strict=True))

    def __call__(self, points_mm: NDArray) -> NDArray[np.float64]:
        """Velocity (n, 3) in m/s at (n, 3) mm."""
        points = np.asarray(points_mm, float)
        index = (points - np.asarray(self.first_mm)) / np.asarray(self.spacing_mm)
        last = np.asarray(self.velocity_m_s.shape[2::-1]) - 1
        if self.outside == "periodic":
            return self._at(np.mod(index, last + 1))
        off = (index < -ROUNDING) | (index > last + ROUNDING)
        if off.any() and self.outside == "error":
            axis = int(off.any(0).argmax())
            (lo, hi), asked = self.limits_mm[axis], points[:, axis]
            raise PlenoPIVError(
                f"flow: {self.name}: asked for {'xyz'[axis]} = {asked.min():.3f} to {asked.max():.3f} mm in the file's "
                f"frame, it holds {'xyz'[axis]} = {lo:.3f} to {hi:.3f} mm; reduce the volume or margin_mm, move at_mm, "
                'or set outside = "zero" or "periodic"'
            )
        velocity = self._at(np.clip(index, 0.0, last))
        velocity[off.any(1)] = 0.0
        return velocity

    def _at(self, index: NDArray) -> NDArray[np.float64]:
        """Velocity (n, 3) at grid indices along x, y, z."""
        return np.concatenate([spline(index[:, ::-1]) for spline in self._splines], -1)


def _spline(values: NDArray) -> Any:
    """The interpolating spline of degree five over grid indices (z, y, x) of values (z, y, x, 3), "not-a-knot".

    Of degree three along an axis of four or five points.
    """
    from scipy.interpolate import NdBSpline, make_interp_spline

    coefficients, knots, degrees = values, [], []
    for axis, points in enumerate(values.shape[:3]):
        degrees.append(DEGREE if points > DEGREE else 3)
        fitted = make_interp_spline(np.arange(points, dtype=float), coefficients, k=degrees[-1], axis=axis)
        coefficients = np.moveaxis(fitted.c, 0, axis)
        knots.append(fitted.t)
    return NdBSpline(tuple(knots), np.ascontiguousarray(coefficients), tuple(degrees))


def _mixed_splines(values: NDArray) -> tuple[Any, ...]:
    """Splines of u, v, w over grid indices (z, y, x), each of degree four along its own direction and three across.

    A B-spline of degree four between two grid points has as its derivative the difference of those of degree three at
    the two points. So du/dx, dv/dy and dw/dz are in one space of cubic splines, and the divergence has the coefficients
    sum_j 2i sin(k_j h_j / 2) / h_j c_j in Fourier space. With c_j = (k_j h_j / 2) / sin(k_j h_j / 2) u_j / b, where b
    makes cubic splines interpolate, they are i k . u / b: zero where the Fourier series is free of divergence. At grid
    points the values differ from those given by an error of fourth order.
    """
    from scipy.interpolate import NdBSpline
    from scipy.ndimage import spline_filter1d

    splines = []
    for component in range(3):
        own = 2 - component  # x is the last axis
        coefficients, knots, degrees = values[..., component], [], []
        for axis, points in enumerate(coefficients.shape):
            degree = 4 if axis == own else 3
            coefficients = spline_filter1d(coefficients, 3, axis=axis, mode="grid-wrap")
            if axis == own:
                coefficients = _between_points(coefficients, axis)
            first = -(degree // 2)  # of the B-splines that reach into the period
            reach = np.arange(first, first + points + degree)
            coefficients = np.take(coefficients, reach, axis=axis, mode="wrap")
            knots.append(np.arange(-degree, points + degree + 1, dtype=float))
            degrees.append(degree)
        splines.append(NdBSpline(tuple(knots), np.ascontiguousarray(coefficients)[..., None], tuple(degrees)))
    return tuple(splines)


def _between_points(values: NDArray, axis: int) -> NDArray:
    """Periodic values half a point further along an axis, modes raised by (k h / 2) / sin(k h / 2)."""
    points = values.shape[axis]
    half = np.pi * np.arange(points // 2 + 1) / points  # k h / 2
    factor = np.exp(1j * half) / np.sinc(half / np.pi)
    shape = [1] * values.ndim
    shape[axis] = -1
    return np.fft.irfft(np.fft.rfft(values, axis=axis) * factor.reshape(shape), points, axis=axis)
