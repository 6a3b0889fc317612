"""A velocity field whose values say where they belong."""

import numpy as np
import xarray as xr

SHAPE = (3, 4, 5)  # z, y, x
DIMS = ("time", "z", "y", "x")


def phases():
    """Fields of three phases, whose mean times fall and coincide; w says by thousands which phase it is."""
    given = field(3).assign_coords(time=[0.5, 0.25, 0.25])
    given["phase"] = "time", [0.0, 120.0, 240.0], {"units": "degree"}
    given["pairs"] = "time", np.array([3, 4, 3], np.int32), {"units": "1"}
    return given


def field(times=1):
    """u = x, v = 10 y, w = 100 z (and 1000 a step of time) in m/s per mm; one vector replaced, one unseen."""
    z, y, x = (
        first + step * np.arange(n) for first, step, n in zip((-1.0, 2.0, -3.0), (0.5, 0.25, 2.0), SHAPE, strict=True)
    )
    t = np.arange(times, dtype=float)
    tt, zz, yy, xx = np.meshgrid(t, z, y, x, indexing="ij")
    valid = np.ones(tt.shape, np.int8)
    valid[:, 1, 1, 2] = 0
    u = xx.copy()
    u[:, 0, 0, 0] = np.nan
    values = {"u": u, "v": 10 * yy, "w": 100 * zz + 1000 * tt, "u_std": 0 * xx, "v_std": 0 * xx, "w_std": 1 + 0 * xx}
    variables = {name: (DIMS, value, {"units": "m s-1"}) for name, value in values.items()} | {"valid": (DIMS, valid)}
    return xr.Dataset(variables, {"time": 0.5 + t, "z": z, "y": y, "x": x}, {"dt_s": 0.001, "frame": "camera"})
