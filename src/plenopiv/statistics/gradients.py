"""Velocity gradients, vorticity, Q and divergence with error bars.

A derivative is a weighted sum of the vectors along one axis, D u; its variance is

    sum_ij D_i D_j std_i std_j r(|i - j|)

with r the correlation of the errors of vectors so many steps apart (Sciacchitano & Wieneke 2016, PIV uncertainty
propagation, Meas. Sci. Technol. 27 084006, for vorticity by central differences). Windows that overlap share particles,
which makes r(1) positive: 0.57 with the default windows, 0.47 without sub-windows, where r(2), on which a central
difference depends, is 0.07 and -0.04. r is computed from the windows by ``displacement.noise_amplification``, for noise
that is white in the volume; in simulated volumes it is up to 0.15 smaller with sub-windows (docs/statistics.md).

Errors of different components are taken as independent, and so are those of the differences of one component along
different axes, which share no vector and whose remaining correlations cancel by symmetry. Q is propagated to first
order: where it is not large against its error, that is not normally distributed. Replaced vectors are fits to their
neighbours, with errors that are correlated more than those of others.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.velocity import of_tracks, q_criterion, velocity_gradient, vorticity

if TYPE_CHECKING:
    import xarray as xr

DIMS = ("z", "y", "x")
APART = 2  # vectors over which a difference reaches
_INSIDE = 9  # windows along each axis in which the correlation is computed: none of the middle one is at a face


def velocity_gradients(field: xr.Dataset, settings: CorrelationSettings | None = None) -> xr.Dataset:
    """du_dx, du_dy, ... dw_dz, vorticity_x, vorticity_y, vorticity_z, divergence in 1/s and q in 1/s^2, on (z, y, x),
    each with its standard deviation ``<name>_std`` where the field has those of the velocity, and is one of windows: of
    tracks errors of neighbours are correlated otherwise (``tracking.field.TrackField.gradient`` has derivatives).

    ``field``: one time, u, v, w and (may be left out) u_std, v_std, w_std in m/s on coordinates in mm. ``settings``:
    those that it was measured with, for the correlation of neighbouring errors; None: the defaults.

    Raises:
        PlenoPIVError: an axis with a single vector, or several times.
    """
    import xarray as xr

    g = velocity_gradient(field)
    correlation = neighbour_correlation(settings or CorrelationSettings())
    known = all(f"{name}_std" in field for name in "uvw") and not of_tracks(field)
    std = np.zeros(g.shape[1:])
    if known:
        std = np.stack([field[f"{name}_std"].transpose(*DIMS).values.astype(float) for name in "uvw"])
    variance = np.empty_like(g)
    for j, axis in enumerate("xyz"):
        place_m = field[axis].values * 1e-3
        variance[:, j] = _of_derivative(std, place_m, correlation[j], 3 - j)
    found: dict[str, tuple[NDArray, NDArray]] = {
        f"d{name}_d{axis}": (g[i, j], variance[i, j]) for i, name in enumerate("uvw") for j, axis in enumerate("xyz")
    }
    turning = vorticity(g)
    for axis, values, (a, b) in zip(
        "xyz", turning, (((2, 1), (1, 2)), ((0, 2), (2, 0)), ((1, 0), (0, 1))), strict=True
    ):
        found[f"vorticity_{axis}"] = values, variance[a] + variance[b]
    found["divergence"] = np.einsum("ii...", g), np.einsum("ii...", variance)
    found["q"] = q_criterion(g), np.einsum("ji...,ij...->...", g**2, variance)  # dQ/dG_ij = -G_ji
    variables: dict = {}
    for name, (values, square) in found.items():
        text, units = _meaning(name)
        about = {"units": units, "long_name": text, "ancillary_variables": f"{name}_std"}
        variables[name] = DIMS, values, about
        if not known:
            del about["ancillary_variables"]
            continue
        variables[f"{name}_std"] = (
            DIMS,
            np.sqrt(square),
            {"units": units, "long_name": f"standard deviation of the error of the {text}"},
        )
    coordinates = {axis: field[axis] for axis in DIMS} | ({"time": field["time"]} if "time" in field.coords else {})
    return xr.Dataset(
        variables,
        coordinates,
        {"Conventions": "CF-1.11", "title": "Velocity gradients", "source": "central differences"},
    )


def _meaning(name: str) -> tuple[str, str]:
    if name == "q":
        return "Q-criterion, half of spin less strain", "s-2"
    if name == "divergence":
        return "divergence of the velocity", "s-1"
    what, _, axis = name.partition("_")
    if what == "vorticity":
        return f"vorticity along {axis}", "s-1"
    return f"derivative of the velocity along {'xyz'['uvw'.index(what[1])]} in the direction of {axis[1]}", "s-1"


def _of_derivative(
    std: NDArray[np.float64], place_m: NDArray[np.float64], correlation: NDArray[np.float64], axis: int
) -> NDArray[np.float64]:
    """Variance (3, nz, ny, nx) of the derivatives along an axis of values with ``std`` (same shape), as
    ``velocity_gradient`` takes them; ``correlation``: of vectors 0, 1, 2 steps apart."""
    n = place_m.size
    weights = np.asarray(np.gradient(np.eye(n), place_m, axis=0, edge_order=2 if n > 2 else 1))  # (derivative, vector)
    values = np.moveaxis(std, axis, 0)
    total = np.zeros(values.shape)
    for apart in range(min(APART, n - 1) + 1):
        both = weights[:, apart:] * weights[:, : n - apart] * (correlation[apart] * (2 if apart else 1))
        product = values[apart:] * values[: n - apart]
        total += np.einsum("pi,i...->p...", both, np.nan_to_num(product))
        unknown = np.einsum("pi,i...->p...", (both != 0).astype(float), np.isnan(product).astype(float))
        total[unknown > 0] = np.nan
    total[np.isnan(values)] = np.nan
    return np.moveaxis(total.clip(0), 0, axis)


@lru_cache(maxsize=16)
def neighbour_correlation(settings: CorrelationSettings) -> NDArray[np.float64]:
    """Correlation (3, 3) along x, y, z of the errors of vectors 0, 1 and 2 steps apart, for white noise in the volume
    and windows away from the faces. Computed once for each ``settings``."""
    from plenopiv.displacement.noise_amplification import noise_amplification
    from plenopiv.displacement.resolution import averaged_share
    from plenopiv.displacement.sub_windows import mean_weights
    from plenopiv.displacement.windows import step_of, window_grid

    last = settings.windows[-1]
    shape = tuple(n + (_INSIDE - 1) * step_of(n, settings.overlap) for n in last[::-1])
    windows = window_grid(shape, last, settings.overlap)  # type: ignore[arg-type]
    if settings.sub_window is None:
        rows: Sequence[NDArray[np.float64]] = [np.eye(n) for n in windows.shape]
        covariance = noise_amplification(windows, settings).covariance
    else:
        inner = window_grid(shape, settings.sub_window, settings.inner_overlap)  # type: ignore[arg-type]
        rows = mean_weights(windows, inner, extrapolate=True, share=averaged_share(settings))
        covariance = noise_amplification(inner, settings).covariance
    out = np.empty((3, APART + 1))
    for axis in range(3):
        for apart in range(APART + 1):
            pairs = [
                _by_distance(w, apart * (k == 2 - axis), n)
                for k, (w, n) in enumerate(zip(rows, covariance.shape, strict=True))
            ]
            out[axis, apart] = np.einsum("abc,a,b,c->", covariance, *pairs)
    return out / out[:, :1]


def _by_distance(weights: NDArray[np.float64], apart: int, count: int) -> NDArray[np.float64]:
    """Sums (count,) of the products of the weights (windows, vectors) of the middle window and of one ``apart``, by how
    far apart the vectors are; the middle of ``count`` is no distance."""
    middle = len(weights) // 2
    all_of_them = np.correlate(weights[middle + apart], weights[middle], "full")
    none, half = weights.shape[1] - 1, count // 2
    padded = np.pad(all_of_them, half)
    return padded[none : none + count]
