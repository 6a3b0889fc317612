"""Steady flows: velocity in m/s at points in mm, and the advection of particles.

Every flow is a callable ``(n, 3) mm -> (n, 3) m/s``; ``flow(name, **parameters)`` makes one by name. The analytic ones
are free of divergence and have a closed form to test against; "jet" and "file" come from ``flow_file``. Angles turn
right-handed about the axis named: about +y, z turns towards x.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flow_file import LARGEST, FlowFile, Jet, in_range

Vector = tuple[float, float, float]
Velocity = Callable[[NDArray], NDArray]
M_PER_MM = 1e-3
MM_PER_M = 1e3
SMALLEST = 1e-9  # mm
POSITIVE = ("core_radius_mm", "radius_mm", "wavelength_mm")


def _axis(name: str) -> int:
    if name not in ("x", "y", "z"):
        raise PlenoPIVError(f"flow: axis '{name}' is none, give 'x', 'y' or 'z'")
    return "xyz".index(name)


def _checked(velocity: Velocity) -> None:
    """Raise PlenoPIVError, naming flow and parameter, where one is no number or three of its kind, or a length that
    divides is not above zero."""
    kind = type(velocity)
    name = next((known for known, each in ANALYTIC.items() if each is kind), kind.__name__)
    for each in fields(velocity):  # type: ignore[arg-type]
        value, said = getattr(velocity, each.name), f"flow: '{name}': {each.name}"
        if each.type == "Vector":
            if not isinstance(value, tuple | list | np.ndarray) or len(value) != 3 or not all(map(in_range, value)):
                raise PlenoPIVError(f"{said} = {value!r:.60}; give three numbers up to {LARGEST:g}, along x, y and z")
        elif each.type == "float":
            if not in_range(value):
                raise PlenoPIVError(f"{said} = {value!r:.60}; give a number up to {LARGEST:g}")
            if each.name in POSITIVE and not value >= SMALLEST:
                raise PlenoPIVError(f"{said} = {value!r:.60}; give a length above 0")


@dataclass(frozen=True)
class Uniform:
    """The same velocity (u, v, w) in m/s everywhere."""

    velocity_m_s: Vector = (0.1, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        return np.broadcast_to(np.asarray(self.velocity_m_s, float), points_mm.shape).copy()


@dataclass(frozen=True)
class Shear:
    """Plane shear: the velocity ``component`` grows along the axis ``along``, from zero at the origin, plus a drift."""

    rate_per_s: float = 50.0
    component: str = "x"
    along: str = "z"
    drift_m_s: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)
        if _axis(self.component) == _axis(self.along):
            raise PlenoPIVError("flow: a shear's component and along must be two different axes")

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        out = np.broadcast_to(np.asarray(self.drift_m_s, float), points_mm.shape).copy()
        out[:, _axis(self.component)] += self.rate_per_s * M_PER_MM * points_mm[:, _axis(self.along)]
        return out


@dataclass(frozen=True)
class Rotation:
    """Solid-body rotation about y through ``centre_mm``, u = omega (z - z0), w = -omega (x - x0), plus a drift."""

    rate_rad_s: float = 80.0
    centre_mm: Vector = (0.0, 0.0, 0.0)
    drift_m_s: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        r = points_mm - np.asarray(self.centre_mm, float)
        out = np.broadcast_to(np.asarray(self.drift_m_s, float), points_mm.shape).copy()
        out[:, 0] += self.rate_rad_s * M_PER_MM * r[:, 2]
        out[:, 2] -= self.rate_rad_s * M_PER_MM * r[:, 0]
        return out


@dataclass(frozen=True)
class LambOseen:
    """Lamb-Oseen vortex: u_theta = Gamma / (2 pi r) (1 - exp(-r^2 / r_c^2)) about an axis through ``centre_mm``."""

    circulation_mm2_s: float = 500.0
    core_radius_mm: float = 1.0
    axis: str = "z"
    centre_mm: Vector = (0.0, 0.0, 0.0)
    drift_m_s: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)
        _axis(self.axis)

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        k = _axis(self.axis)
        i, j = (k + 1) % 3, (k + 2) % 3  # right-handed: from axis i towards axis j
        r = points_mm - np.asarray(self.centre_mm, float)
        q = (r[:, i] ** 2 + r[:, j] ** 2) / self.core_radius_mm**2
        # u_theta / r; expm1 keeps the centre, where it tends to Gamma / (2 pi r_c^2)
        ratio = np.where(q > 0, -np.expm1(-q) / np.where(q > 0, q, 1.0), 1.0)
        rate = self.circulation_mm2_s / (2.0 * pi * self.core_radius_mm**2) * ratio * M_PER_MM
        out = np.broadcast_to(np.asarray(self.drift_m_s, float), points_mm.shape).copy()
        out[:, i] -= rate * r[:, j]
        out[:, j] += rate * r[:, i]
        return out


@dataclass(frozen=True)
class VortexRing:
    """A circular vortex filament with a smoothed core (Rosenhead-Moore), plus a drift.

    u = Gamma / (4 pi) * integral of dl x r / (r^2 + c^2)^(3/2): the curl of a potential, so divergence-free for any
    core ``c``. With the complete elliptic integrals it is the field of a current loop in which z^2 becomes
    z^2 + c^2 (Lamb, Hydrodynamics, art. 161). On the axis u = Gamma R^2 / (2 (R^2 + c^2 + z^2)^(3/2)).
    """

    circulation_mm2_s: float = 1500.0
    radius_mm: float = 2.0
    core_radius_mm: float = 0.8
    axis: str = "x"
    centre_mm: Vector = (0.0, 0.0, 0.0)
    drift_m_s: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)
        _axis(self.axis)

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        from scipy.special import ellipe, ellipk

        k = _axis(self.axis)
        i, j = (k + 1) % 3, (k + 2) % 3
        r = points_mm - np.asarray(self.centre_mm, float)
        big, along, rho = self.radius_mm, r[:, k], np.hypot(r[:, i], r[:, j])
        height2 = along**2 + self.core_radius_mm**2
        alpha2, beta2 = (big + rho) ** 2 + height2, (big - rho) ** 2 + height2
        m = 4.0 * big * rho / alpha2
        big_k, big_e = ellipk(m), ellipe(m)
        factor = self.circulation_mm2_s / (2.0 * pi * np.sqrt(alpha2)) * M_PER_MM
        axial = factor * (big_k + (big**2 - rho**2 - height2) / beta2 * big_e)
        # divided by rho once for the formula and once for the direction; zero on the axis, where both lose their digits
        off_axis = rho > 1e-5 * big
        safe = np.where(off_axis, rho, 1.0)
        radial = factor * along / safe**2 * (-big_k + (big**2 + rho**2 + height2) / beta2 * big_e)
        radial = np.where(off_axis, radial, 0.0)
        out = np.broadcast_to(np.asarray(self.drift_m_s, float), points_mm.shape).copy()
        out[:, k] += axial
        out[:, i] += radial * r[:, i]
        out[:, j] += radial * r[:, j]
        return out


@dataclass(frozen=True)
class ABC:
    """Arnold-Beltrami-Childress flow of one wavelength: curl u = (2 pi / wavelength) u.

    u = A sin kz + C cos ky,  v = B sin kx + A cos kz,  w = C sin ky + B cos kx, with (A, B, C) = ``amplitudes_m_s``.
    """

    wavelength_mm: float = 4.8
    amplitudes_m_s: Vector = (0.1, 0.1, 0.1)
    drift_m_s: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self)

    def __call__(self, points_mm: NDArray) -> NDArray:  # noqa: D102
        a, b, c = self.amplitudes_m_s
        x, y, z = (2.0 * pi / self.wavelength_mm) * np.asarray(points_mm, float).T
        u = a * np.sin(z) + c * np.cos(y)
        v = b * np.sin(x) + a * np.cos(z)
        w = c * np.sin(y) + b * np.cos(x)
        return np.stack([u, v, w], -1) + np.asarray(self.drift_m_s, float)


ANALYTIC: dict[str, type] = {
    "uniform": Uniform,
    "shear": Shear,
    "rotation": Rotation,
    "vortex-ring": VortexRing,
    "abc": ABC,
    "lamb-oseen": LambOseen,
}
FLOWS: dict[str, type] = {**ANALYTIC, "jet": Jet, "file": FlowFile}


def _nearest(wrong: str, right: list[str]) -> str:
    close = difflib.get_close_matches(wrong, right, 1, 0.0)
    return f"did you mean '{close[0]}'? (there are {', '.join(right)})"


def flow(name: str, **parameters: Any) -> Velocity:
    """A flow by its name in ``FLOWS`` with its dataclass' parameters.

    Raises PlenoPIVError for an unknown name or parameter, naming the nearest right one, and for a file that cannot be
    used.
    """
    if name not in FLOWS:
        raise PlenoPIVError(f"flow: no flow is called '{name}', {_nearest(name, list(FLOWS))}")
    known = [f.name for f in fields(FLOWS[name])]
    for key in parameters:
        if key not in known:
            raise PlenoPIVError(f"flow: '{name}' has no parameter '{key}', {_nearest(key, known)}")
    for each in fields(FLOWS[name]):
        if each.default is MISSING and each.name not in parameters:
            raise PlenoPIVError(f"flow: '{name}' needs the parameter '{each.name}'")
    return FLOWS[name](**{k: tuple(v) if isinstance(v, (list, np.ndarray)) else v for k, v in parameters.items()})


def describe(velocity: Velocity) -> tuple[str, dict[str, Any]]:
    """Name and parameters of a flow for the record; any other callable goes by its own name, without parameters."""
    for name, kind in FLOWS.items():
        if isinstance(velocity, kind):
            return name, asdict(velocity)  # type: ignore[call-overload]
    return getattr(velocity, "__name__", type(velocity).__name__), {}


def advect(velocity: Velocity, points_mm: ArrayLike, dt_s: float, steps: int = 8) -> NDArray[np.float64]:
    """Points (n, 3) in mm carried along a steady flow for ``dt_s`` (may be negative), fourth-order Runge-Kutta."""
    x = np.array(points_mm, dtype=np.float64)
    h = dt_s / steps * MM_PER_M  # (m/s) h is in mm
    for _ in range(steps):
        k1 = velocity(x)
        k2 = velocity(x + 0.5 * h * k1)
        k3 = velocity(x + 0.5 * h * k2)
        k4 = velocity(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x
