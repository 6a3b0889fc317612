"""Fields whose statistics are known."""

import numpy as np
import pytest
import xarray as xr

DIMS = ("z", "y", "x")


def as_field(values, std=0.0, valid=None, inside=None, time=None):
    """``values`` (3, nz, ny, nx) in m/s as a field; ``std`` (3, nz, ny, nx) or a number."""
    shape = values.shape[1:]
    std = np.broadcast_to(std, values.shape)
    variables = {n: (DIMS, v) for n, v in zip("uvw", values, strict=True)}
    variables |= {f"{n}_std": (DIMS, v) for n, v in zip("uvw", std, strict=True)}
    variables["valid"] = DIMS, np.ones(shape, np.int8) if valid is None else valid.astype(np.int8)
    if inside is not None:
        variables["inside_body"] = DIMS, inside.astype(np.int8)
    field = xr.Dataset(variables, {axis: 0.5 * np.arange(n) - 1.0 for axis, n in zip(DIMS, shape, strict=True)})
    for axis in DIMS:
        field[axis].attrs["units"] = "mm"
    return field if time is None else field.expand_dims(time=[time])


@pytest.fixture
def field_of():
    return as_field
