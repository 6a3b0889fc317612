"""What it costs to carry volumes from lens space to the laboratory's grid:  laboratory_grid.py [PAIRS] [FOLDER]

Pairs of the small camera (benchmarks/accuracy/small_recording.py), reconstructed on the grid of the laboratory, and on
voxels that lie a fraction of a voxel beside it along all axes, then carried over: with the weights of a linear
interpolation, as reconstruction/resampling.py does, and of cubic convolution (Keys 1981), negative light left out.
Prints RMS errors and bias in voxels, the share of errors within one stated standard deviation, and listed voxels.
FOLDER: for the recordings, by default build/laboratory_grid.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import plenopiv
from plenopiv.accuracy import Score, score_velocity
from plenopiv.cameras.space_map import Polynomial
from plenopiv.chain import Chain
from plenopiv.displacement.multigrid import measure
from plenopiv.reconstruction.resampling import resampled
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.velocity import velocity_dataset
from plenopiv.volume import SparseVolume, VoxelGrid

sys.path.insert(0, str(Path(__file__).parents[1] / "accuracy"))
from small_recording import CAMERA, DT_S, WINDOWS, clean_recording

BESIDE = (0.0, 0.25, 0.5)  # voxels

Carried = Callable[[SparseVolume, VoxelGrid], SparseVolume]


def linear(volume: SparseVolume, grid: VoxelGrid) -> SparseVolume:
    """As the program does it."""
    corners = np.stack(np.meshgrid(*grid.limits_mm(), indexing="ij"), -1).reshape(-1, 3)
    return resampled(volume, Polynomial.fitted(corners, corners, 1), grid)


def cubic(volume: SparseVolume, grid: VoxelGrid) -> SparseVolume:
    """By cubic convolution along each axis, of voxels of one size."""
    out = volume.dense().values.astype(float)
    for axis, (source, target, voxel) in enumerate(
        zip(volume.grid.axes()[::-1], grid.axes()[::-1], grid.voxel_mm[::-1], strict=True)
    ):
        d = np.abs(target[:, None] - source) / voxel
        near, far = (1.5 * d - 2.5) * d * d + 1, ((2.5 - 0.5 * d) * d - 4) * d + 2
        weights = np.where(d < 1, near, np.where(d < 2, far, 0.0))
        out = np.moveaxis(np.tensordot(weights, out, (1, axis)), 0, axis)
    kept = out > 1e-6 * out.max()
    return SparseVolume.from_mask(grid, kept).with_values(out[kept].astype(np.float32))


def beside(grid: VoxelGrid, fraction: float) -> VoxelGrid:
    """Voxels of the same size, a fraction of one beside those of ``grid``, and two more along each axis."""
    x, y, z = (f - (1 - fraction) * d for f, d in zip(grid.first_mm, grid.voxel_mm, strict=True))
    nz, ny, nx = grid.shape
    return VoxelGrid((x, y, z), grid.voxel_mm, (nz + 2, ny + 2, nx + 2))


def scored(chain: Chain, volumes: list[SparseVolume], truth: tuple[np.ndarray, np.ndarray]) -> Score:
    """The vectors between two volumes against the particles."""
    grid = volumes[0].grid
    field = velocity_dataset(measure(volumes[0], volumes[1], chain.correlation), grid, DT_S)
    return score_velocity(field, *truth, CAMERA, dt_s=DT_S, voxel_mm=grid.voxel_mm, window_voxels=WINDOWS[-1])


def main(pairs: int, folder: Path) -> None:
    """Measure and print."""
    recorded = clean_recording(folder, pairs)
    experiment = plenopiv.load(str(recorded.folder / "experiment.toml"))
    chain, recording, _ = calibrated_chain(experiment, experiment.recording())
    found: dict[str, list[tuple[Score, int]]] = {}
    for pair in range(pairs):
        images, truth = [recording.light(k)[0] for k in recording.pairs[pair]], recorded.truth(pair)

        def add(name: str, volumes: list[SparseVolume], truth: tuple[np.ndarray, np.ndarray] = truth) -> None:
            found.setdefault(name, []).append((scored(chain, volumes, truth), volumes[0].values.size))

        add("on the grid itself", [chain.weighted(chain.reconstruct([image]).volume) for image in images])
        for fraction in BESIDE:
            other = replace(chain, grid=beside(chain.grid, fraction))
            volumes = [other.weighted(other.reconstruct([image]).volume) for image in images]
            ways: dict[str, Carried] = {"linear": linear, "cubic": cubic}
            for name, way in ways.items():
                add(f"{name}, {fraction:g} beside", [way(volume, chain.grid) for volume in volumes])
    print(f"{pairs} pairs\n| volumes | RMS x, y, z | bias x, y, z | within 1 std | listed |\n|---|---|---|---|---:|")
    for name, scores in found.items():
        rms = np.sqrt(np.mean([np.square(score.final.rms) for score, _ in scores], axis=0))
        bias = np.mean([score.final.bias for score, _ in scores], axis=0)
        within = np.mean([score.inside_1_std for score, _ in scores], axis=0)
        columns = (" ".join(f"{value:.4f}" for value in values) for values in (rms, bias))
        listed = np.mean([count for _, count in scores])
        print(f"| {name} | {' | '.join(columns)} | {' '.join(f'{w:.2f}' for w in within)} | {listed:.0f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4, Path(*sys.argv[2:] or ["build/laboratory_grid"]))
