"""What the paper left open: "Further analysis is underway to normalize the voxel intensity" (section 4).

Light, energy and sharpness of reconstructed planes against depth, where they come from, and what evening them out does
to Q and to displacements.

python paper/normalisation.py              picture to docs/images/paper, numbers to paper/results/normalisation.json
python paper/normalisation.py --reduced --out FOLDER      a smaller volume, all to FOLDER
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
import xarray as xr
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from plenopiv.accuracy.volumes import exact_volume, reconstruction_quality
from plenopiv.cameras.presets import preset
from plenopiv.design.advice import suggested
from plenopiv.design.twin import DT_S, Pair, reconstructed_pair
from plenopiv.reconstruction.focus import focus_weight
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import SparseVolume

ROOT = Path(__file__).parents[1]
PICTURES, RESULTS = ROOT / "docs" / "images" / "paper", ROOT / "paper" / "results"
DEPTH_MM, REDUCED_DEPTH_MM = (-4.0, 4.0), (-1.5, 1.5)
PIXELS = 2000  # of the sensor, so that it sees that depth
INNER = 0.8  # of the volume's width: where its borders do not matter
END_PLANES = 3
COLOURS = {
    "none": "#8794a1",
    "equal light": "#1f6fb2",
    "equal energy": "#3c8d4f",
    "focus": "#d9822b",
    "both": "#c0392b",
}
TITLES = {
    "none": "as reconstructed",
    "equal light": "planes of equal light",
    "equal energy": "planes of equal energy",
    "focus": "less weight near focus (default)",
    "both": "equal energy, less weight near focus",
}

Array = NDArray[np.float64]


def by_plane(volume: SparseVolume) -> dict[str, Array]:
    """Of every plane's inner part: light (sum of E), energy (sum of E^2), and the voxels that the light fills,
    (sum E)^2 / sum E^2; each (nz,)."""
    nz, ny, nx = volume.grid.shape
    low, high = (int(0.5 * (1 - INNER) * n) for n in (ny, nx))
    light, energy = np.empty(nz), np.empty(nz)
    for k in range(nz):
        plane = volume.slab(k, k + 1)[0, low : ny - low, high : nx - high].astype(np.float64)
        light[k], energy[k] = plane.sum(), (plane**2).sum()
    return {"light": light, "energy": energy, "filled": light**2 / np.maximum(energy, 1e-30)}


def smooth(values: Array, planes: int = 5) -> Array:
    """A running mean, which takes out single particles."""
    padded = np.pad(values, planes // 2, mode="edge")
    return np.convolve(padded, np.ones(planes) / planes, "valid")


def weights(pair: Pair) -> dict[str, NDArray[np.float32]]:
    """What planes are multiplied by, (nz,), one name each; the mean of both frames decides."""
    planes = [by_plane(frame.volume) for frame in pair.frames]
    light, energy = (smooth(0.5 * (planes[0][name] + planes[1][name])) for name in ("light", "energy"))
    z = pair.measurement.grid.axes()[2]
    focus = focus_weight(pair.camera, z, ReconstructionSettings.focus_reach)
    even = np.sqrt(energy.mean() / energy)
    found = {
        "none": np.ones(z.size),
        "equal light": light.mean() / light,
        "equal energy": even,
        "focus": focus,
        "both": even * focus,
    }
    return {name: weight.astype(np.float32) for name, weight in found.items()}


def planes_scaled(volume: SparseVolume, weight: NDArray[np.float32]) -> SparseVolume:
    """The same voxels, those of plane k times ``weight[k]`` (nz,)."""
    listed = np.diff(volume.row_start[:: volume.grid.shape[1]])
    return volume.with_values(volume.values * np.repeat(weight.astype(np.float32), listed))


def quality(pair: Pair, weight: NDArray[np.float32]) -> float:
    """Q of the first frame against Gaussians of 3 voxels, its planes multiplied by ``weight``."""
    particles = pair.particles[0]
    exact = exact_volume(particles.position_mm, particles.electrons, pair.measurement.grid)
    return reconstruction_quality(planes_scaled(pair.frames[0].volume, weight), exact)


def displaced(pair: Pair, weight: Array) -> xr.Dataset:
    """The velocity field of a pair, planes multiplied by ``weight`` (nz,) alone."""
    unweighted = replace(pair.chain, reconstruction=replace(pair.chain.reconstruction, focus_reach=0.0))
    a, b = (planes_scaled(frame.volume, weight) for frame in pair.frames)
    return unweighted.velocity(a, b, DT_S)


def measured(depth_mm: tuple[float, float], vectors: int) -> dict[str, Any]:
    """All numbers."""
    camera = preset("pmr14")
    camera = replace(camera, sensor=replace(camera.sensor, columns=PIXELS, rows=PIXELS))  # a twin is cut out of it
    asked = suggested(camera, depth_mm)
    pair = reconstructed_pair(camera, asked, vectors=vectors)
    rays = reconstructed_pair(camera, asked, vectors=vectors, weights="1-ray")
    z = pair.measurement.grid.axes()[2]
    found: dict[str, Any] = {
        "z_mm": z,
        "planes": {"exact": by_plane(pair.frames[0].volume), "1-ray": by_plane(rays.frames[0].volume)},
        "true_light": _true_light(pair, z),
        "dead_zone_mm": pair.camera.dead_zone_mm(),
        "weights": {},
    }
    for name, weight in weights(pair).items():
        field = displaced(pair, weight)
        planes = pair.by_plane(field)
        found["weights"][name] = {
            "weight": weight,
            "q": quality(pair, weight),
            "rms": pair.score(field).final.rms,
            "gross": pair.score(field).final.gross,
            "vector_z_mm": [p.z_mm for p in planes],
            "rms_by_plane": [p.rms for p in planes],
        }
    return found


def _true_light(pair: Pair, z: Array) -> Array:
    """Light of the particles in each plane's inner part (nz,), in counts as voxels have it."""
    particles, grid = pair.particles[0], pair.measurement.grid
    (_, x1), (_, y1), _ = pair.measurement.limits_mm
    at = particles.position_mm
    inside = (np.abs(at[:, 0]) < INNER * x1) & (np.abs(at[:, 1]) < INNER * y1)
    edges = np.append(z - 0.5 * grid.voxel_mm[2], z[-1] + 0.5 * grid.voxel_mm[2])
    return np.histogram(at[inside, 2], edges, weights=particles.electrons[inside])[0]


def draw(found: dict[str, Any], to: Path) -> None:
    """Four panels: light, energy and filling of planes; errors in the plane and in depth."""
    figure, ((light, energy), (plane, depth)) = plt.subplots(2, 2, figsize=(11, 7.6), layout="constrained")
    z = found["z_mm"]
    for axes in (light, energy, plane, depth):
        axes.axvspan(*found["dead_zone_mm"], color="#dde2e7", zorder=0)
        axes.set_xlabel("z (mm), toward the camera")
        axes.spines[["top", "right"]].set_visible(False)
    true = smooth(found["true_light"], 9)
    light.plot(z, true / true.mean(), color="#1f2933", linewidth=0.9, label="particles")
    for rule, colour in (("exact", "#1f6fb2"), ("1-ray", "#d9822b")):
        planes = found["planes"][rule]
        for axes, name in ((light, "light"), (energy, "energy")):
            values = smooth(planes[name], 9)
            axes.plot(z, values / values.mean(), color=colour, label=f"{rule} weights")
    light.set(ylabel="of the mean", title="light of a plane")
    energy.set(ylabel="of the mean", title="energy of a plane, the sum of squares")
    for axes in (light, energy):
        axes.set_ylim(bottom=0)
        axes.legend(frameon=False, fontsize=8)
    for name, result in found["weights"].items():
        rms = np.array(result["rms_by_plane"])
        across = np.sqrt(0.5 * (rms[:, 0] ** 2 + rms[:, 1] ** 2))
        for axes, values in ((plane, across), (depth, rms[:, 2])):
            axes.plot(result["vector_z_mm"], values, "o-", markersize=3, color=COLOURS[name], label=TITLES[name])
    plane.set(ylabel="RMS error (voxel)", title="displacement in the plane")
    depth.set(ylabel="RMS error (voxel)", title="displacement in depth")
    for axes in (plane, depth):
        axes.set_ylim(bottom=0)
    depth.legend(frameon=False, fontsize=7, loc="upper left")
    figure.savefig(to / "normalisation.png", dpi=100)
    plt.close(figure)


def main(reduced: bool = False, out: Path | None = None) -> None:
    """Measure, draw, write."""
    pictures, results = (PICTURES, RESULTS) if out is None else (out, out)
    for folder in (pictures, results):
        folder.mkdir(parents=True, exist_ok=True)
    found = measured(REDUCED_DEPTH_MM if reduced else DEPTH_MM, 30 if reduced else 400)
    draw(found, pictures)
    text = json.dumps(found, default=lambda a: np.asarray(a, np.float64).round(6).tolist(), indent=1)
    (results / "normalisation.json").write_text(text + "\n")
    for name, result in found["weights"].items():
        rms = " ".join(f"{e:.3f}" for e in result["rms"])
        print(f"{TITLES[name]:42s} Q {result['q']:.3f}, RMS x y z {rms}, gross {100 * result['gross']:.1f} %")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reduced", action="store_true")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    main(asked.reduced, asked.out)
