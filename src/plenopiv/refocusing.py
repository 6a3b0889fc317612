"""Pictures from a light field before anything is reconstructed: what one view sees, and shift-and-add refocusing.

The light that a point (x, y, z) sends through the place (u, v) of the main lens meets the microlens plane at

    s = A(z) u + B(z) x,      t = A(z) v + B(z) y                                                    (Eqs. 1-3)

so a view, which looks through one (u, v), is a picture of any plane z once it is read there. A refocused picture is the
mean of these over all views (Ng et al. 2005, Light field photography with a hand-held plenoptic camera): what lies at z
adds up to a point, all else is spread over |A(z) - A(z')| P_m.

Between the microlenses values are interpolated linearly: on squares, or on the triangles of a hexagonal lattice.
Pictures are for inspection; reconstruction uses the raw pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.coverage import half_sensor_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.lightfield import Layout, LightField

if TYPE_CHECKING:
    import xarray

Axis = NDArray[np.float64]


def image_axes(camera: PlenopticCamera, step_mm: float | None = None) -> tuple[Axis, Axis]:
    """Places of a picture's pixels in mm: x of its columns, rising, and y of its rows, falling (row 0 on top).

    They cover the focal plane as far as the sensor sees it through the middle of the main lens; ``step_mm`` apart, by
    default p_l/|M|, one microlens.

    Raises:
        PlenoPIVError: ``step_mm`` is not positive.
    """
    if step_mm is not None and not 0 < step_mm < inf:
        raise PlenoPIVError(f"step_mm = {step_mm:g} between a picture's pixels; give a positive number of mm")
    magnified = abs(camera.main_lens.magnification)
    step = camera.lattice.pitch_mm / magnified if step_mm is None else step_mm
    counts = [max(1, int(2 * half / magnified / step)) for half in half_sensor_mm(camera)]
    x, y = ((np.arange(n, dtype=np.float64) - 0.5 * (n - 1)) * step for n in counts)
    return x, y[::-1].copy()


def sub_aperture(
    lightfield: LightField, view: int, x_mm: ArrayLike | None = None, y_mm: ArrayLike | None = None
) -> xarray.DataArray:
    """What one view sees, read at the focal plane: float32 on (y, x) in mm, row 0 at the largest y by default.

    Counts of a pixel that the aperture lights wholly. The picture's pixels are at ``x_mm``, ``y_mm`` (1-D), by default
    ``image_axes``; NaN where no microlens nearby has a pixel of this view. Views are numbered as in ``Layout.offsets``.

    Raises:
        PlenoPIVError: there is no such view.
    """
    where = lightfield.layout
    _check_view(view, where)
    x, y = _axes(where.camera, x_mm, y_mm)
    return _picture(*_seen_through(lightfield, view, 0.0, x, y), x, y, 0.0)


def refocused(
    lightfield: LightField,
    z_mm: float,
    x_mm: ArrayLike | None = None,
    y_mm: ArrayLike | None = None,
    views: Iterable[int] | None = None,
) -> xarray.DataArray:
    """All ``views`` added up at depth ``z_mm`` of the object frame: float32 on (y, x) in mm, row 0 at the largest y by
    default.

    The mean over views, in counts of a pixel that the aperture lights wholly. Axes as in ``sub_aperture``, in mm at
    ``z_mm``; NaN where no view sees.

    Raises:
        PlenoPIVError: z is not in front of the main lens, or there is no such view.
    """
    where = lightfield.layout
    lens_z = where.camera.main_lens.object_distance_mm
    if not z_mm < lens_z:
        raise PlenoPIVError(f"z = {z_mm:g} mm is not in front of the main lens, which is at z = {lens_z:.6g} mm")
    x, y = _axes(where.camera, x_mm, y_mm)
    light, share = np.zeros((y.size, x.size)), np.zeros((y.size, x.size))
    for view in range(where.views) if views is None else views:
        _check_view(view, where)
        counts, lit = _seen_through(lightfield, view, z_mm, x, y)
        light += counts
        share += lit
    return _picture(light, share, x, y, z_mm)


def _check_view(view: int, where: Layout) -> None:
    if not 0 <= view < where.views:
        raise PlenoPIVError(f"view {view}: this camera has views 0 to {where.views - 1}")


def _axes(camera: PlenopticCamera, x_mm: ArrayLike | None, y_mm: ArrayLike | None) -> tuple[Axis, Axis]:
    x, y = image_axes(camera)
    return (x if x_mm is None else np.asarray(x_mm, float)), (y if y_mm is None else np.asarray(y_mm, float))


def _picture(light: NDArray, share: NDArray, x: Axis, y: Axis, z_mm: float) -> xarray.DataArray:
    """Counts over the lit share of the pixels that gave them; NaN where hardly any did."""
    import xarray

    values = np.where(share > 0.05, light / np.maximum(share, 0.05), np.nan).astype(np.float32)
    places = {name: (name, axis, {"units": "mm"}) for name, axis in (("y", y), ("x", x))}
    about = {"units": "counts", "long_name": "mean of the views"}
    return xarray.DataArray(values, {**places, "z": ((), z_mm, {"units": "mm"})}, ("y", "x"), "picture", about)


def _seen_through(
    lightfield: LightField, view: int, z_mm: float, x: Axis, y: Axis
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Counts and lit share of a view's pixels, interpolated to the points (x, y, z); both (y, x)."""
    where = lightfield.layout
    camera = where.camera
    a, b = float(camera.spread(z_mm)), float(camera.scale(z_mm))
    m, n = where.offsets[view]
    s, t = np.broadcast_arrays(a * m * camera.portion_mm + b * x, (-a * n * camera.portion_mm + b * y)[:, None])
    if a != 0.0:  # a pixel misses its nominal portion of the main lens by its microlens' phase
        nearest = _lens_number(where, *camera.lattice.nearest(s, t))
        phase = where.phase[np.maximum(nearest, 0)]
        s, t = s - a * camera.portion_mm * phase[..., 0], t + a * camera.portion_mm * phase[..., 1]
    light, share = np.zeros(s.shape), np.zeros(s.shape)
    for i, j, weight in _neighbours(camera.lattice, s, t):
        lens = _lens_number(where, i, j)
        weight = np.where((lens >= 0) & where.seen[view, lens], weight, 0.0)
        light += weight * lightfield.values[view, lens]
        share += weight * where.fill[view, lens] * (1.0 if where.light is None else where.light[view, lens])
    return light, share


def _lens_number(where: Layout, i: NDArray, j: NDArray) -> NDArray[np.int64]:
    """Flat numbers of lenses (i, j) in the layout's block; -1 of those outside."""
    inside = (i >= where.i0) & (i < where.i0 + where.ni) & (j >= where.j0) & (j < where.j0 + where.nj)
    return np.where(inside, (j - where.j0) * where.ni + (i - where.i0), -1)


def _neighbours(lattice: Lattice, s_mm: NDArray, t_mm: NDArray) -> list[tuple[NDArray, NDArray, NDArray]]:
    """Lenses (i, j) around points of the microlens plane with the weights of a linear interpolation, which add to 1."""
    along, across = lattice.coordinates(s_mm, t_mm)
    row = across / lattice.row_spacing
    if lattice.kind == "square":
        i, j = np.floor(along).astype(np.int64), np.floor(row).astype(np.int64)
        p, q = along - i, row - j
        return [
            (i, j, (1 - p) * (1 - q)),
            (i + 1, j, p * (1 - q)),
            (i, j + 1, (1 - p) * q),
            (i + 1, j + 1, p * q),
        ]
    # Oblique coordinates along the lattice's two short vectors; a rhombus of theirs is two equilateral triangles.
    oblique = along - 0.5 * row
    k, j = np.floor(oblique).astype(np.int64), np.floor(row).astype(np.int64)
    p, q = oblique - k, row - j
    upper = p + q > 1
    near, far = np.where(upper, 1, 0), np.where(upper, p + q - 1, 1 - p - q)
    corners = [
        (k + near, j + near, far),
        (k + 1, j, np.where(upper, 1 - q, p)),
        (k, j + 1, np.where(upper, 1 - p, q)),
    ]
    return [(k + (j >> 1), j, weight) for k, j, weight in corners]  # rows are shifted by half a pitch, alternately
