"""Synthetic velocity fields in front of a camera, with the particles that they would have been measured from."""

import numpy as np
import xarray as xr

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import advect

DT_S = 0.0005
VOXEL_MM = (0.02, 0.02, 0.08)
WINDOW = (32, 32, 12)
HALF_MM = np.array([0.32, 0.32, 0.48])
TO_VOXELS = 1e3 * DT_S / np.array(VOXEL_MM)  # m/s -> voxels per frame
CAMERA = PlenopticCamera(MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(900, 700, 0.0055))


def field_and_particles(flow, error_voxels=(0.0, 0.0, 0.0), n=6000, box=(1.6, 1.2, 2.0), seed=3):
    """A field of the flow's velocity plus an error, and its particles at the two frames (a, b)."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, (n, 3)) * box
    a, b = (advect(flow, middle, sign * 0.5 * DT_S) for sign in (-1, 1))
    axes = {
        name: np.arange(-reach, reach + 1e-9, step)
        for name, reach, step in zip("xyz", (1.59, 1.21, 1.9), (0.32, 0.33, 0.475), strict=True)
    }
    z, y, x = np.meshgrid(axes["z"], axes["y"], axes["x"], indexing="ij")
    velocity = flow(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
    velocity = velocity + np.asarray(error_voxels) / TO_VOXELS
    dims = ("time", "z", "y", "x")
    variables = {name: (dims, velocity[None, ..., i].copy()) for i, name in enumerate("uvw")}
    variables |= {f"{name}_raw": (dims, velocity[None, ..., i].copy()) for i, name in enumerate("uvw")}
    variables["valid"] = (dims, np.ones((1, *x.shape), np.int8))
    return xr.Dataset(variables, {"time": [0.0], **axes}), a, b
