"""Velocity fields for comparisons, and results folders of them."""

import numpy as np
import xarray as xr

from plenopiv.io import write_velocity

DIMS = ("time", "z", "y", "x")
DT_S = 0.5e-3
VOXEL_MM = (0.02, 0.02, 0.08)
SETTINGS = """
[recording]
white = "../white.tif"
frames = ["../a.tif", "../b.tif"]
dt_s = 0.0005

[volume]
voxel_mm = [0.02, 0.02, 0.08]

[correlation]
windows = [[64, 64, 24], [48, 48, 16]]
overlap = 0.5

[output]
directory = "."
"""


def axis(first, step, count):
    return first + step * np.arange(count)


def linear(z, y, x, times=(0.00025,)):
    """u = 1 + x, v = 2y - z, w = 3z + x + 10 t in m/s per mm; all measured, standard deviations 0.1, 0.2, 0.3."""
    t, zz, yy, xx = np.meshgrid(np.asarray(times, float), z, y, x, indexing="ij")
    values = {"u": 1 + xx, "v": 2 * yy - zz, "w": 3 * zz + xx + 1e4 * t}
    values |= {f"{name}_std": np.full(t.shape, std) for name, std in zip("uvw", (0.1, 0.2, 0.3), strict=True)}
    variables = {name: (DIMS, value) for name, value in values.items()}
    variables["valid"] = (DIMS, np.ones(t.shape, np.int8))
    return xr.Dataset(variables, dict(zip(DIMS, (np.asarray(times, float), z, y, x), strict=True)), {"dt_s": DT_S})


def regular(times=(0.00025,), shape=(6, 5, 7)):
    return linear(axis(-1.0, 0.4, shape[0]), axis(-0.5, 0.25, shape[1]), axis(0.0, 0.25, shape[2]), times)


def results(folder, dataset, settings=SETTINGS):
    folder.mkdir(parents=True)
    write_velocity(folder / "velocity.nc", dataset)
    if settings is not None:
        (folder / "experiment.toml").write_text(settings)
    return folder
