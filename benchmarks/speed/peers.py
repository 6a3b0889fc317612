"""Reconstruction against peers that store their weights:  peers.py [--size N ...]

- MART view by view with `scipy.sparse` matrices, and ASTRA's SIRT (Palenstijn et al. 2011; GPL, run as a process of its
  own), with the exact weights that this project's maps interpolate, for volumes of growing size;
- pyolaf's Richardson-Lucy (Stefanoiu et al. 2019), which stores one image for each voxel under a microlens and depth.

Each is a process of its own, from images, and weights if it stores them, in memory to the volume, on as many threads as
it knows to use: of the peers none uses two. What it takes to compute their weights is left out. Packages are installed
into build/peers. Writes peers.json beside this file and prints a table.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from reconstruction import ROUNDS, measured
from scene import DEPTH_MM, LATERAL_MM, Scene
from scipy import sparse

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction import reconstruct as chain
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles

sys.path.append(str(Path(__file__).parents[1] / "reconstruction"))
from pixel_sequential import light_of_a_pixel, shares

HERE = Path(__file__).parent
SIZES = ((40, 40, 40), (80, 80, 50), (120, 120, 80), (160, 160, 100))  # the last fills 12 GB
ENVIRONMENT = HERE.parents[1] / "build" / "peers"
PACKAGES = ("astra-toolbox==2.5.0", "pyolaf==0.2.1")
PIXELS = 15  # behind a microlens, for pyolaf: odd
LENSES, PLANES = 11, 5  # for pyolaf
LUCY_ROUNDS = 1  # each takes as long as the others
WAVE_RAYS = 4000


def python() -> Path:
    """The interpreter of the peers' environment, made when it is missing."""
    found = ENVIRONMENT / "bin" / "python"
    if not found.exists():
        subprocess.run([sys.executable, "-m", "venv", ENVIRONMENT], check=True)
    if subprocess.run([found, "-c", "import astra, pyolaf"], stderr=subprocess.DEVNULL).returncode:
        subprocess.run([found, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    return found


def run_peer(method: str, folder: Path, rounds: int = ROUNDS) -> dict[str, float]:
    """Seconds, GB and residual (counts RMS) of a peer on what lies in ``folder``."""
    command = [python(), HERE / "reconstruction_peer.py", method, folder, str(rounds)]
    ended = subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE)
    seconds, gb, residual = map(float, ended.stdout.split("\n")[-2].split())
    return {"seconds": seconds, "gb": gb, "residual": residual}


def ours(scene: Scene) -> dict[str, dict[str, float]]:
    """MART as a run has it, and with every voxel kept, each in a process of its own."""
    found = {}
    for name, thin in (("MART", chain.THIN), ("MART, not thinned", 0.0)):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            found[name] = pool.submit(measured, scene, "mart", thin).result()
    return found


def write_weights(scene: Scene, folder: Path) -> int:
    """Weights as one CSR matrix (view x lens, voxel) of the counts that a voxel of value 1 gives; images; how many
    weights there are, in bytes."""
    where = scene.lightfield.layout
    projector = PlenopticProjector(where, scene.grid, "polygons")
    volume = projector.visible_voxels()
    light = light_of_a_pixel(projector, volume)
    data, indices, rows = [], [], [np.zeros(1, np.int64)]
    for view in range(projector.views):
        (matrix,) = shares(projector, volume, [view])  # type: ignore[arg-type]
        by_lens = sparse.csr_array(matrix.T)
        data.append(by_lens.data * light[by_lens.indices])
        indices.append(by_lens.indices.astype(np.int32))
        rows.append(rows[-1][-1] + by_lens.indptr[1:].astype(np.int64))
    np.save(folder / "data.npy", np.concatenate(data))
    np.save(folder / "indices.npy", np.concatenate(indices))
    np.save(folder / "indptr.npy", np.concatenate(rows))
    np.save(folder / "light.npy", light)
    np.save(folder / "measured.npy", np.where(where.seen, scene.lightfield.values, 0.0).astype(np.float32))
    np.save(folder / "seen.npy", where.seen)
    return sum(d.nbytes + i.nbytes for d, i in zip(data, indices, strict=True))


def stored_weights(sizes: tuple[tuple[int, int, int], ...]) -> list[dict]:
    """A row for each size."""
    rows = []
    for shape in sizes:
        scene = Scene(shape, (LATERAL_MM, LATERAL_MM, DEPTH_MM))
        with tempfile.TemporaryDirectory() as scratch:
            stored = write_weights(scene, Path(scratch))
            found = {
                "scipy.sparse MART": run_peer("mart", Path(scratch)),
                "ASTRA SIRT": run_peer("sirt", Path(scratch)),
            }
        rows.append({"shape": shape, "stored_gb": stored / 1e9, "found": ours(scene) | found})
        show(rows[-1])
    return rows


def show(row: dict) -> None:
    """Print a row's figures."""
    size = " x ".join(map(str, row["shape"]))
    print(f"{size} voxels, weights of {row['stored_gb']:.2f} GB:")
    for name, f in row["found"].items():
        print(f"  {name:20s} {f['seconds']:8.2f} s {f['gb']:6.2f} GB, residual {f['residual']:.1f} counts", flush=True)


def odd_camera() -> PlenopticCamera:
    """Square microlenses of 15 x 15 px."""
    camera = preset("pmr14")
    pitch = PIXELS * camera.sensor.pixel_pitch_mm
    focal = camera.microlens_focal_length_mm * pitch / camera.lattice.pitch_mm
    side = LENSES * PIXELS
    return replace(
        camera,
        lattice=replace(camera.lattice, pitch_mm=pitch),
        microlens_focal_length_mm=focal,
        main_lens=MainLens(camera.main_lens.focal_length_mm, camera.main_lens.aperture_mm, -1.0),
        sensor=replace(camera.sensor, columns=side, rows=side),
    )


def write_patterns(folder: Path) -> None:
    """For each voxel under the middle microlens, a pixel wide, and each plane its image; and an image of particles."""
    camera, pixel = odd_camera(), odd_camera().sensor.pixel_pitch_mm
    z = DEPTH_MM * (np.arange(PLANES) - PLANES // 2) * 4
    at = pixel * (np.arange(PIXELS) - PIXELS // 2)
    side = LENSES * PIXELS
    patterns = np.empty((PLANES, PIXELS, PIXELS, side, side), np.float32)
    for k, depth in enumerate(z):
        for j, down in enumerate(at):
            for i, x in enumerate(at):
                one = Particles(np.array([[x, -down, depth]]), np.ones(1))
                patterns[k, j, i] = particle_image(camera, one, rays=WAVE_RAYS)
    np.save(folder / "patterns.npy", patterns)
    rng, half = np.random.default_rng(0), 0.35 * side * pixel
    where = rng.uniform(-1, 1, (LENSES**2 // 4, 3)) * [half, half, z[-1]]
    particles = Particles(where, np.full(len(where), 1e5))
    np.save(folder / "measured.npy", particle_image(camera, particles).astype(np.float32) + 1)


def richardson_lucy() -> dict:
    """pyolaf, and MART of as many voxels."""
    side = LENSES * PIXELS
    with tempfile.TemporaryDirectory() as scratch:
        write_patterns(Path(scratch))
        found = {"pyolaf": run_peer("richardson-lucy", Path(scratch), LUCY_ROUNDS)}
    scene = Scene((side, side, PLANES), (0.0055, 0.0055, 4 * DEPTH_MM), pixels=(side, side))
    row = {
        "shape": (side, side, PLANES),
        "stored_gb": 4e-9 * PLANES * PIXELS**2 * side**2,
        "found": ours(scene) | found,
    }
    show(row)
    return row


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, nargs="+", help="voxels along x of the sizes to measure anew; default: all")
    chosen, target = parser.parse_args().size, HERE / "peers.json"
    if chosen is None:
        row = richardson_lucy()
        found = {"rounds": ROUNDS, "stored weights": stored_weights(SIZES), "richardson-lucy": row}
    else:
        found = json.loads(target.read_text())
        anew = {row["shape"][0]: row for row in stored_weights(tuple(s for s in SIZES if s[0] in chosen))}
        found["stored weights"] = [anew.get(row["shape"][0], row) for row in found["stored weights"]]
    target.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
