"""What volumes kept on disk take, and how long:  kept_volumes.py [FOLDER]

The first frame of the small camera (benchmarks/accuracy/small_recording.py) at three densities, reconstructed, and the
densest one repeated with other intensities until 1.6 million voxels are kept, for the times: its places repeat too, and
take no space. Each is kept as a run does (io/volumes.py) and as dense VTKHDF for ParaView, packed as it is written
(deflate level 1) and as small as its filters make it. Writes kept_volumes.json beside this file and prints a table.
FOLDER: for the recordings, by default build/kept_volumes.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

import plenopiv
from plenopiv.io.volumes import read_volume, write_volume
from plenopiv.io.vtkhdf import write_volume_vtkhdf
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.simulation.simulated_recording import Seeding
from plenopiv.volume import SparseVolume, VoxelGrid

sys.path.insert(0, str(Path(__file__).parents[1] / "accuracy"))
from small_recording import clean_recording

DENSITIES = (0.5, 1.0, 2.0)  # particles per microlens
REPEATED = (1, 6, 8)  # along z, y, x
HEAD = (
    "| volume | voxels, millions | kept | kept, % | bytes a kept voxel | dense VTKHDF | VTKHDF, smallest "
    "| write, s | read, s |"
)


def reconstructed(folder: Path, density: float) -> SparseVolume:
    """The first frame of a recording of the small camera."""
    recorded = clean_recording(folder / f"{density:g}", 1, Seeding(density))
    experiment = plenopiv.load(str(recorded.folder / "experiment.toml"))
    chain, recording, _ = calibrated_chain(experiment, experiment.recording())
    return chain.reconstruct([recording.light(0)[0]]).volume


def repeated(volume: SparseVolume) -> SparseVolume:
    """A volume next to itself many times, its intensities multiplied by random factors."""
    dense = np.tile(volume.dense().values, REPEATED)
    dense *= np.random.default_rng(0).uniform(0.9, 1.1, dense.shape).astype(np.float32)
    grid = VoxelGrid(volume.grid.first_mm, volume.grid.voxel_mm, dense.shape)
    return SparseVolume.from_mask(grid, dense > 0).with_values(dense[dense > 0])


def smallest_dense(volume: SparseVolume, path: Path) -> int:
    """Bytes of the dense array in one chunk, the better of deflate with and without byte shuffle."""
    found = []
    for shuffle in (False, True):
        with h5py.File(path, "w") as file:
            packed = {"compression": "gzip", "compression_opts": 9, "shuffle": shuffle}
            file.create_dataset("intensity", data=volume.dense().values, chunks=volume.grid.shape, **packed)
        found.append(path.stat().st_size)
    return min(found)


def measured(volume: SparseVolume, folder: Path) -> dict[str, float]:
    """Sizes in bytes a kept voxel, times in s."""
    kept, dense = folder / "volume.h5", folder / "volume.vtkhdf"
    began = time.perf_counter()
    write_volume(kept, volume)
    written = time.perf_counter()
    read = read_volume(kept)
    ended = time.perf_counter()
    assert read.values.tobytes() == volume.values.tobytes()
    assert np.array_equal(read.column, volume.column)
    assert np.array_equal(read.row_start, volume.row_start)
    write_volume_vtkhdf(dense, volume)
    count = volume.values.size
    return {
        "voxels": volume.grid.size,
        "kept": count,
        "bytes_a_kept_voxel": kept.stat().st_size / count,
        "dense_vtkhdf": dense.stat().st_size / count,
        "smallest_dense": smallest_dense(volume, folder / "dense.h5") / count,
        "write_s": written - began,
        "read_s": ended - written,
    }


def main() -> None:
    """Measure, print, write."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "build" / "kept_volumes"
    results = {}
    print(HEAD + "\n|---|" + "---:|" * (HEAD.count("|") - 2))
    with tempfile.TemporaryDirectory() as made:
        volumes = {f"{d:g} per microlens": reconstructed(folder, d) for d in DENSITIES}
        volumes["the last one, repeated"] = repeated(list(volumes.values())[-1])
        for name, volume in volumes.items():
            r = results[name] = measured(volume, Path(made))
            print(
                f"| {name} | {r['voxels'] / 1e6:.1f} | {r['kept']} | {100 * r['kept'] / r['voxels']:.2f} "
                f"| {r['bytes_a_kept_voxel']:.2f} | {r['dense_vtkhdf']:.2f} | {r['smallest_dense']:.2f} "
                f"| {r['write_s']:.2f} | {r['read_s']:.2f} |"
            )
    Path(__file__).with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
