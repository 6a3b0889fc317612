"""Small files for the tests of flows from files."""

import numpy as np
import xarray

POINTS = (8, 7, 6)  # along x, y, z
FIRST, SPACING = (-1.0, 0.5, 2.0), (0.25, 0.5, 0.125)


def linear(p):
    """u grows with z, v with x, w with y, each at its own rate: whatever is swapped or turned round shows."""
    return np.stack([0.1 * p[..., 2], 0.2 * p[..., 0] + 0.01, 0.3 * p[..., 1] - 0.02], -1)


def axes():
    return [a + h * np.arange(n) for a, h, n in zip(FIRST, SPACING, POINTS, strict=True)]


def grid():
    """Points (z, y, x, 3) in mm."""
    x, y, z = axes()
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    return np.stack([x, y, z], -1)


def dataset(length="mm", speed="m/s", per_mm=1.0, per_m_s=1.0):
    """``linear`` as u, v, w on (z, y, x) in these units; a ``None`` writes no units."""
    x, y, z = axes()
    values = linear(grid()) * per_m_s
    coordinates = {
        name: (name, a * per_mm, {"units": length} if length else {}) for name, a in zip("xyz", (x, y, z), strict=True)
    }
    variables = {
        name: (("z", "y", "x"), values[..., k], {"units": speed} if speed else {}) for k, name in enumerate("uvw")
    }
    return xarray.Dataset(variables, coordinates)


def write(data, path):
    data.to_netcdf(path, engine="h5netcdf")
    return str(path)
