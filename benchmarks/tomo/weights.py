"""One camera at a time and squares, as PlenoPIV has it, beside Elsinga's one pixel at a time and his weights.

    .venv/bin/python benchmarks/tomo/weights.py     # half a minute

Stored weights and plain loops, on a small volume: the same pixels, the same voxels to start from, 5 iterations. Elsinga
et al. (2006, section 2) take as a weight the volume that a line of sight, a cylinder as thick as a pixel, shares with a
sphere as large as the voxel. Weights of one voxel in one camera sum to 1.00 +- 0.02 then.
"""

from __future__ import annotations

import json
from math import pi
from pathlib import Path

import numpy as np
from four_cameras import ELECTRONS, Scene
from numba import njit
from scipy import sparse

from plenopiv.accuracy import exact_volume, ghost_light, reconstruction_quality
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.reconstruction.candidates import lit_above
from plenopiv.reconstruction.noise import Noise
from plenopiv.reconstruction.reconstruct import SMALLEST_FLOOR, reconstruct
from plenopiv.reconstruction.settings import TOMOGRAPHY

HERE = Path(__file__).parent
SCENE = Scene((96, 96, 24), (128, 128), 0.05)
DENSITIES = (0.025, 0.05, 0.1)
ROUNDS = 5
SPHERE, CYLINDER = (3 / (4 * pi)) ** (1 / 3), pi**-0.5  # radii: of a cubic voxel's volume, of a square pixel's area


def square(distance):
    """Share of a square shadow of one pixel, its centre so far from the pixel's along columns and rows (..., 2)."""
    return np.prod(np.maximum(1.0 - np.abs(distance), 0.0), -1)


def sphere_in_cylinder(distance):
    """Share of the sphere within the cylinder, by the distance of its centre from the cylinder's axis."""
    nodes = (np.arange(400) + 0.5) / 400 * 2 - 1
    x, y = np.meshgrid(SPHERE * nodes, SPHERE * nodes)
    height = 2 * np.sqrt(np.maximum(SPHERE**2 - x**2 - y**2, 0.0))
    table = np.linspace(0.0, SPHERE + CYLINDER, 200)
    inside = [height[np.hypot(x - d, y) < CYLINDER].sum() / height.sum() for d in table]
    return np.interp(np.hypot(*np.moveaxis(distance, -1, 0)), table, inside, right=0.0)


def stored(camera, grid, voxel, weight):
    """Weights (pixel, voxel) of listed voxels in one camera, by rows."""
    x, y, z = grid.axes()
    k, j, i = np.unravel_index(voxel, grid.shape)
    place = camera.project(np.stack([x[i], y[j], z[k]], -1))
    offset = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 2), -1).reshape(-1, 2)
    pixel = np.rint(place).astype(int)[:, None] + offset
    value = weight(pixel - place[:, None])
    sensor = camera.sensor
    on = (value > 0) & (pixel >= 0).all(-1) & (pixel < [sensor.columns, sensor.rows]).all(-1)
    column = np.broadcast_to(np.arange(len(voxel))[:, None], on.shape)[on]
    shape = (sensor.rows * sensor.columns, len(voxel))
    return sparse.csr_matrix((value[on], (pixel[on][:, 1] * sensor.columns + pixel[on][:, 0], column)), shape)


@njit
def one_round(start, voxel, weight, measured, floor, values):
    """Elsinga et al. (2006, Eq. 3), pixel by pixel, relaxation 1."""
    for p in range(len(start) - 1):
        light = 0.0
        for n in range(start[p], start[p + 1]):
            light += weight[n] * values[voxel[n]]
        ratio = (measured[p] + floor) / (light + floor)
        for n in range(start[p], start[p + 1]):
            values[voxel[n]] *= ratio ** weight[n]


def by_pixels(matrices, images, values, order):
    for _ in range(ROUNDS):
        for view in order.permutation(len(matrices)):
            m = matrices[view]
            one_round(m.indptr, m.indices, m.data, images[view].astype(float), SMALLEST_FLOOR, values)
    return values


def by_cameras(matrices, images, values, order):
    for _ in range(ROUNDS):
        for view in order.permutation(len(matrices)):
            m, total = matrices[view], np.asarray(matrices[view].sum(0)).ravel()
            ratio = (images[view] + SMALLEST_FLOOR) / (m @ values + SMALLEST_FLOOR)
            values *= np.maximum(1 + m.T @ (ratio - 1) / np.maximum(total, 1.0), 0.0)
    return values


def main() -> list[dict]:
    rows = []
    for ppp in DENSITIES:
        scene = SCENE.having(ppp=ppp)
        projector = PinholeProjector(scene.known_cameras, scene.grid)
        images = projector.values_of(scene.images())
        exact = exact_volume(scene.place_mm, ELECTRONS, scene.grid)
        start = projector.candidates(images, lit_above(images, Noise(0.0)))
        voxel = np.flatnonzero(start.with_values(np.ones_like(start.values)).dense().values)
        volumes = {"shipped": reconstruct(images, projector, TOMOGRAPHY).volume}
        for weights, weight in (("squares", square), ("spheres in cylinders", sphere_in_cylinder)):
            matrices = [stored(camera, scene.grid, voxel, weight) for camera in scene.known_cameras]
            for steps, method in (("cameras", by_cameras), ("pixels", by_pixels)):
                values = method(matrices, images, start.values.astype(float), np.random.default_rng(0))
                volumes[f"{weights}, by {steps}"] = start.with_values(values.astype(np.float32))
        for name, volume in volumes.items():
            rows.append({
                "ppp": ppp, "case": name, "Q": round(reconstruction_quality(volume, exact), 4),
                "ghost_light": round(ghost_light(volume, scene.place_mm), 4),
            })  # fmt: skip
            print(rows[-1], flush=True)
    (HERE / "weights.json").write_text("[\n" + ",\n".join(" " + json.dumps(row) for row in rows) + "\n]\n")
    return rows


if __name__ == "__main__":
    main()
