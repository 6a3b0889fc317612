"""The velocity field as the page's 3D scene and slices read it: thinned, with what turns in it, as JSON."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from plenopiv.velocity import q_criterion, velocity_gradient, vorticity

if TYPE_CHECKING:
    import xarray

VECTORS = 60_000  # at most so many are put into the page: 2 MB
COLOURS = {"speed": "viridis", "component": "RdBu_r"}
STOPS = 17  # of a colour map, interpolated in between
# name of a vortex criterion: (what the page calls it, unit)
CRITERIA = {"q": ("Q-criterion", "1/s²"), "vorticity": ("vorticity", "1/s")}


def field_data(dataset: xarray.Dataset) -> dict[str, Any]:
    """What the scripts of the page draw of the first time of a velocity field, dims (time, z, y, x).

    ``axes`` in mm; ``values`` float32 little-endian in base64, x running fastest: u, v, w in m/s, valid, and the vortex
    criteria; ``criteria`` which of these can be drawn, with the range of levels, and ``start`` the one that is drawn at
    first, "" where the whole flow turns, as in a solid-body rotation: a surface would then wrap noise alone;
    ``largest`` velocities for the colour bars; ``step`` every how many vectors one was taken. Derivatives are of the
    whole field, before thinning.
    """
    field = dataset.isel(time=0).transpose("z", "y", "x", ...)
    values = {name: field[name].values for name in ("u", "v", "w", "valid")}
    values |= _turning(field)
    step = thinning(values["u"].shape)
    cut = tuple(slice(None, None, s) for s in step)
    thinned = {name: full[cut] for name, full in values.items()}
    speed = np.sqrt(sum(values[name].astype(float) ** 2 for name in "uvw"))
    return {
        "axes": {axis: field[axis].values[::s].astype(float).tolist() for axis, s in zip("zyx", step, strict=True)},
        "step": dict(zip("zyx", step, strict=True)),
        "values": {name: _packed(part) for name, part in thinned.items()},
        "criteria": {name: levels for name in CRITERIA if (levels := _levels(name, thinned.get(name))) is not None},
        "start": "" if _all_turns(values.get("q")) else "q",
        "largest": {"speed": _largest(speed)} | {name: _largest(values[name]) for name in "uvw"},
        "colours": {
            name: np.rint(255 * colormaps[map](np.linspace(0, 1, STOPS))[:, :3]).astype(int).tolist()
            for name, map in COLOURS.items()
        },
    }


def thinning(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Steps along each axis that leave at most ``VECTORS`` of ``shape``; the longest axis is thinned first."""
    step = [1] * len(shape)
    left = list(shape)
    while np.prod(left) > VECTORS:
        axis = int(np.argmax(left))
        step[axis] += 1
        left[axis] = -(-shape[axis] // step[axis])
    return tuple(step)


def _turning(field: xarray.Dataset) -> dict[str, NDArray]:
    """Vortex criteria on the field's grid; none of a field without extent along some axis."""
    if min(field.sizes[axis] for axis in "xyz") < 2:
        return {}
    gradient = velocity_gradient(field[["u", "v", "w"]])
    return {"q": q_criterion(gradient), "vorticity": np.sqrt((vorticity(gradient) ** 2).sum(0))}


def _levels(name: str, values: NDArray | None) -> dict[str, Any] | None:
    """Range of levels of an isosurface; None where nothing turns."""
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    if not finite.size:
        return None
    low, high = np.percentile(finite, (2.0, 99.5))
    low = max(float(low), 0.0)
    label, unit = CRITERIA[name]
    return {"name": name, "label": label, "unit": unit, "low": low, "high": float(high)} if high > low else None


def _all_turns(q: NDArray | None) -> bool:
    """Whether Q is positive in nine vectors of ten."""
    finite = np.empty(0) if q is None else q[np.isfinite(q)]
    return bool(finite.size) and float(np.percentile(finite, 10.0)) > 0.0


def _packed(values: NDArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def _largest(values: NDArray) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, 99.5)) if finite.size else 0.0
