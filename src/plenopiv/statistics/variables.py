"""The variables of statistics.nc: names, units, what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

DIMS = ("z", "y", "x")
NAMES = ("u", "v", "w")
AXES = dict(zip(NAMES, "xyz", strict=True))
INTERVAL = 1.96  # standard deviations of a 95 % interval
STD = "standard deviation of the error of the {}"
STD_COMMENT = (
    f"a 95 % interval is +- {INTERVAL} of it; of sampling, with correlated samples and random errors of vectors"
)

Variables = dict[str, tuple[tuple[str, ...], NDArray]]


def attributes(name: str) -> dict[str, Any]:
    """Attributes of a variable of ``SeriesStatistics.result``."""
    if name == "samples":
        return {"long_name": "number of vectors that count", "units": "1"}
    base, std, _ = name.partition("_std")
    text, units = _meaning(base)
    if not std:
        found = {"units": units, "long_name": text}
        if not base.endswith(("_noise", "_samples")):
            found["ancillary_variables"] = f"{name}_std samples"  # CF 1.11, section 3.4
        return found
    long_name = STD.format(text)
    if name.endswith("_measurement"):
        long_name += ", share of the random errors of vectors"
        comment = "the share of the random errors of vectors, contained in the standard deviation without this suffix"
    else:
        comment = STD_COMMENT + ("; and of what is taken off" if "corrected" in name else "")
    return {"units": units, "long_name": long_name, "comment": comment}


def _meaning(base: str) -> tuple[str, str]:
    """What a variable is, and its unit."""
    along = f"velocity along {AXES[base[0]]}"
    name, _, kind = base.partition("_")
    if kind == "mean":
        return f"mean of the {along}", "m s-1"
    if kind.startswith("rms"):
        less = ", less the random errors of vectors" if kind == "rms_corrected" else ", random errors included"
        return f"RMS fluctuation of the {along}{less}", "m s-1"
    if kind == "skewness":
        return f"skewness of the {along}, random errors included", "1"
    if kind == "independent_samples":
        return f"number of independent samples of the mean of the {along}", "1"
    stress = f"Reynolds stress <{name[0]}'{name[1]}'>"
    if kind == "noise":
        return f"mean variance of the random errors of the {along}, contained in {name}", "m2 s-2"
    if kind == "corrected":
        return f"{stress}, less the random errors of vectors ({name}_noise)", "m2 s-2"
    return stress + (", random errors included" if name[0] == name[1] else ""), "m2 s-2"


RUNNING = {
    "running_pairs": ("number of pairs so far", "1"),
    "running_mean": ("mean of so many pairs", "m s-1"),
    "running_mean_std": (STD.format("mean of so many pairs"), "m s-1"),
    "running_rms": ("RMS fluctuation of so many pairs", "m s-1"),
    "running_rms_std": (STD.format("RMS fluctuation of so many pairs"), "m s-1"),
    **{f"place_{axis}": (f"{axis} of the places where convergence is followed", "mm") for axis in "xyz"},
}


def dataset(
    found: Mapping[str, NDArray],
    coordinates: Mapping[str, xr.DataArray],
    running: Variables,
    about: Mapping[str, Any],
) -> xr.Dataset:
    """``found`` on (z, y, x) and the ``running`` variables as an xarray Dataset with their attributes."""
    import xarray as xr

    variables: dict[str, Any] = {name: (DIMS, values, attributes(name)) for name, values in found.items()}
    for name, (dims, values) in running.items():
        text, units = RUNNING[name]
        variables[name] = dims, values, {"units": units, "long_name": text}
    at: dict[str, Any] = {axis: (axis, coordinates[axis].values, dict(coordinates[axis].attrs)) for axis in DIMS}
    if running:
        at["component"] = "component", np.array(NAMES), {"long_name": "component of the velocity"}
    title = {"Conventions": "CF-1.11", "title": "Statistics of a series of velocity fields"}
    return xr.Dataset(variables, at, title | dict(about))
