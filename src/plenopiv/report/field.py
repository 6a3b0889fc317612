"""The velocity field as the page's 3D scene and slices read it: thinned, quantised, with what turns in it, as JSON."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Colormap, LinearSegmentedColormap
from numpy.typing import NDArray

from plenopiv.report.limits import OF_SPEED, colour_limits
from plenopiv.report.moments import Moment, Series, moments, series_in

if TYPE_CHECKING:
    import xarray

VECTORS = 60_000  # of a time, at most so many are put into the page
IN_ALL = 850_000  # of all times together: 24 MB
TIMES = 100  # on the slider at most
FINE = 4e-5  # of a colour range: what 16 bits must resolve, else values are 32-bit floats
EMPTY = 65535  # NaN
STOPS = 17  # of a colour map, interpolated in between

# name: (what the page calls it, unit)
QUANTITIES = {
    "speed": ("speed", "m/s"),
    "u": ("u (along x)", "m/s"),
    "v": ("v (along y)", "m/s"),
    "w": ("w (along z)", "m/s"),
    "error": ("error bar", "m/s"),
    "peak_ratio": ("peak ratio", ""),
    "vorticity": ("vorticity", "1/s"),
    "q": ("Q-criterion", "1/s²"),
    "divergence": ("divergence", "1/s"),
}
CRITERIA = ("q", "vorticity")  # what isosurfaces enclose
VELOCITIES = ("speed", "u", "v", "w")
# of components on a dark page: zero is grey, and neither zero nor an end fades into the page
DARK = ["#b5ceff", "#6a9ff0", "#3f6fb0", "#56616c", "#b04f40", "#f07f68", "#ffc8b8"]
MAPS: dict[str, dict[str, tuple[Colormap, float, float]]] = {
    "light": {"sequential": (colormaps["viridis"], 0.0, 0.95), "diverging": (colormaps["RdBu_r"], 0.0, 1.0)},
    "dark": {
        "sequential": (colormaps["viridis"], 0.28, 1.0),
        "diverging": (LinearSegmentedColormap.from_list("dark", DARK), 0.0, 1.0),
    },
}


def field_data(dataset: xarray.Dataset, series: Series | None = None) -> dict[str, Any]:
    """What the scripts of the page draw of velocity fields, dims (time, z, y, x).

    ``series``: where the times are read from, else from ``dataset``, whose first time is of their grid.

    ``axes`` in mm, of the ``laboratory`` or else the camera; ``moments``: times, of a series mean and RMS too, each
    with ``values``, packed (``_packed``), x running fastest: u, v, w in m/s, their standard deviations, peak ratio,
    valid, and derivatives; ``quantities``:
    label, unit, colours' limits by kind of moment; ``criteria`` which of these isosurfaces can enclose, with the
    range of levels, and ``start`` the one that is drawn at first, "" where the whole flow turns, as in a solid-body
    rotation: a surface would then wrap noise alone; ``longest`` speed, for arrows; ``step`` every how many vectors one
    was taken; ``first`` the moment shown first. Derivatives are of the whole field, before thinning.
    """
    series = series_in(dataset) if series is None else series
    sizes = [dataset.sizes[axis] for axis in "zyx"]
    step = thinning(tuple(sizes))
    axes = {axis: dataset[axis].values[::s].astype(float).tolist() for axis, s in zip("zyx", step, strict=True)}
    left = int(np.prod([len(axis) for axis in axes.values()]))
    shown = moments(series, step, min(TIMES, IN_ALL // left - 2))
    known = [_with_derived(moment) for moment in shown]
    steady = [values for moment, values in zip(shown, known, strict=True) if moment.kind != "rms"]
    fluctuating = [values for moment, values in zip(shown, known, strict=True) if moment.kind == "rms"]
    limits = _limits(steady)
    return {
        "axes": axes,
        "laboratory": dataset.attrs.get("frame") == "laboratory",
        "step": dict(zip("zyx", step, strict=True)),
        "moments": [_moment(moment, limits) for moment in shown],
        "first": next((k for k, values in enumerate(known) if np.isfinite(values["u"]).any()), 0),
        "quantities": _quantities(limits, _limits(fluctuating)),
        "criteria": {name: levels for name in CRITERIA if (levels := _levels(name, steady)) is not None},
        "start": "" if _all_turns(steady[0].get("q")) else "q",
        "longest": _largest(steady, "speed"),
        "maps": {mode: {name: _stops(*part) for name, part in maps.items()} for mode, maps in MAPS.items()},
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


def _with_derived(moment: Moment) -> dict[str, NDArray]:
    """Its values with speed and error bar, which the page's script computes as well."""
    values = moment.values
    found = values | {"speed": np.sqrt(sum(values[name] ** 2 for name in "uvw"))}
    if "u_std" in values:
        found["error"] = np.sqrt(sum(values[f"{name}_std"] ** 2 for name in "uvw"))
    return found


def _limits(known: Sequence[dict[str, NDArray]]) -> dict[str, tuple[str, float, float]]:
    """Map, low and high of each quantity over all moments."""
    least = OF_SPEED * _largest(known, "speed")
    return {
        name: colour_limits(_joined(known, name), least if name in VELOCITIES else 0.0)
        for name in QUANTITIES
        if any(name in values for values in known)
    }


def _quantities(*limits: dict[str, tuple[str, float, float]]) -> dict[str, Any]:
    """By name what the page says of a quantity; limits of times and mean, and of RMS."""
    steady, fluctuating = limits
    found: dict[str, Any] = {}
    for name, (label, unit) in QUANTITIES.items():
        if name in steady:
            found[name] = {"label": label, "unit": unit, "limits": _said(steady[name])}
            if name in fluctuating:
                found[name]["rms"] = _said(fluctuating[name])
    return found


def _said(limits: tuple[str, float, float]) -> dict[str, Any]:
    return {"map": limits[0], "low": limits[1], "high": limits[2]}


def _moment(moment: Moment, limits: dict[str, tuple[str, float, float]]) -> dict[str, Any]:
    packed = {}
    for name, values in moment.values.items():
        _, low, high = limits.get(name, limits["error" if name.endswith("_std") and "error" in limits else "speed"])
        packed[name] = _packed(values, high - low)
    return {"kind": moment.kind, "label": moment.label, "values": packed}


def _packed(values: NDArray, span: float) -> dict[str, Any]:
    """Numbers in base64, little-endian: small integers as bytes; others in 16 bits, ``low`` + ``step`` x number and
    ``EMPTY`` for NaN, where that resolves ``FINE`` of the ``span`` of their colours; else as 32-bit floats."""
    if values.dtype.kind in "iub":
        return {"kind": "u1", "data": _text(values, "u1")}
    finite = values[np.isfinite(values)]
    low = float(finite.min()) if finite.size else 0.0
    step = (float(finite.max()) - low) / (EMPTY - 1) if finite.size else 0.0
    if step > FINE * span:
        return {"kind": "f4", "data": _text(values, "<f4")}
    number = np.rint((values - low) / (step or 1.0))
    return {"kind": "u2", "low": low, "step": step, "data": _text(np.where(np.isfinite(values), number, EMPTY), "<u2")}


def _text(values: NDArray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values).astype(kind).tobytes()).decode("ascii")


def _levels(name: str, known: Sequence[dict[str, NDArray]]) -> dict[str, Any] | None:
    """Range of levels of an isosurface; None where nothing turns."""
    finite = _joined(known, name)
    if not finite.size:
        return None
    low, high = np.percentile(finite, (2.0, 99.5))
    low = max(float(low), 0.0)
    label, unit = QUANTITIES[name]
    return {"name": name, "label": label, "unit": unit, "low": low, "high": float(high)} if high > low else None


def _all_turns(q: NDArray | None) -> bool:
    """Whether Q is positive in nine vectors of ten."""
    finite = np.empty(0) if q is None else q[np.isfinite(q)]
    return bool(finite.size) and float(np.percentile(finite, 10.0)) > 0.0


def _joined(known: Sequence[dict[str, NDArray]], name: str) -> NDArray:
    """The finite values of all moments."""
    parts = [values[name][np.isfinite(values[name])] for values in known if name in values]
    return np.concatenate(parts) if parts else np.empty(0)


def _largest(known: Sequence[dict[str, NDArray]], name: str) -> float:
    finite = np.abs(_joined(known, name))
    return float(np.percentile(finite, 99.5)) if finite.size else 0.0


def _stops(colours: Colormap, low: float, high: float) -> list[list[int]]:
    shown = colours(np.linspace(low, high, STOPS))[:, :3]
    return [[int(c) for c in row] for row in np.rint(255 * shown)]
