"""One frame as a whole through the code for a graphics processor, on this processor, beside the kernels:

    device_frame.py [NX NY NZ COLUMNS ROWS]

The paper's PMR 14 camera; by default a quarter of the paper's full size, 3300 x 2200 px and 1050 x 700 x 260 voxels,
from which the reconstruction takes its default five iterations. Each device computes in a process of its own. Writes
device-frame.json beside this file: seconds of processor time, programs compiled included, and of wall clock; peak
memory; candidates, voxels kept, residuals; how the volumes are correlated.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scene import DEPTH_MM, LATERAL_MM, Scene

from plenopiv.device.backend import device_of
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import SparseVolume

HERE = Path(__file__).parent
BUILD = HERE.parents[1] / "build" / "device_frame"
SIZE = 1050, 700, 260, 3300, 2200  # voxels along x, y, z; pixels
DEVICES = "cpu", "jax-cpu"
KIB = 1024


def scene(size: tuple[int, ...]) -> Scene:
    nx, ny, nz, *pixels = size
    return Scene((nx, ny, nz), (LATERAL_MM, LATERAL_MM, DEPTH_MM), pixels=(pixels[0], pixels[1]))


def computed(device: str, size: tuple[int, ...]) -> None:
    """Reconstruct the frame on a device, and keep the volume and what it took."""
    about = scene(size)
    values = np.load(BUILD / "values.npy")
    projector = PlenopticProjector(layout(about.camera), about.grid)
    settings, kind = ReconstructionSettings(), device_of("jax-cpu" if device == "jax-cpu" else "cpu")
    begin, processor = time.perf_counter(), time.process_time()
    if kind.kind == "cpu":
        found = reconstruct(values, projector, settings)
    else:
        with kind.in_use():
            from plenopiv.device.reconstruct import reconstruct as on_device

            found = on_device(values, projector, settings)
    taken = {
        "processor_s": time.process_time() - processor,
        "wall_s": time.perf_counter() - begin,
        "peak_memory_gb": KIB * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9,
        "candidates": found.candidates,
        "voxels": int(found.volume.column.size),
        "residuals_counts": list(found.residuals),
    }
    volume = found.volume
    np.savez(BUILD / f"{device}.npz", start=volume.row_start, column=volume.column, values=volume.values)
    (BUILD / f"{device}.json").write_text(json.dumps(taken))


def main() -> None:
    size = tuple(map(int, sys.argv[1:6])) or SIZE
    BUILD.mkdir(parents=True, exist_ok=True)
    np.save(BUILD / "values.npy", scene(size).lightfield.values)
    result: dict[str, Any] = {"voxels": size[:3], "pixels": size[3:]}
    for device in DEVICES:
        subprocess.run([sys.executable, __file__, *map(str, size), device], check=True)
        result[device] = json.loads((BUILD / f"{device}.json").read_text())
        print(device, json.dumps(result[device]), flush=True)
    result["correlated"] = correlated(size)
    (HERE / "device-frame.json").write_text(json.dumps(result, indent=1) + "\n")
    print("correlated at 1 -", 1 - result["correlated"])


def correlated(size: tuple[int, ...]) -> float:
    """How the volumes of both are."""
    grid, both = scene(size).grid, list[np.ndarray]()
    for device in DEVICES:
        with np.load(BUILD / f"{device}.npz") as kept:
            both.append(SparseVolume(grid, kept["start"], kept["column"], kept["values"]).dense().values.ravel())
    sums = [float(each.sum(dtype=np.float64)) / grid.size for each in both]
    one, other = (each - np.float32(mean) for each, mean in zip(both, sums, strict=True))
    products = [float(np.sum(a * b, dtype=np.float64)) for a, b in ((one, other), (one, one), (other, other))]
    return float(products[0] / np.sqrt(products[1] * products[2]))


if __name__ == "__main__":
    if len(sys.argv) == 7:
        computed(sys.argv[6], tuple(map(int, sys.argv[1:6])))
    else:
        main()
