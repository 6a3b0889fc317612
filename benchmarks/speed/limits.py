"""Kernels against the least that they could cost, in one process:  limits.py

For the same voxels, views and lenses:

- forward and back, against loops that do nothing but follow stored indices: for each voxel and each pixel that it
  lights, one index, one weight, one product (as a matrix of weights would be multiplied, two threads over voxels; the
  scatter into two images). Pairs of a voxel and a pixel are counted with exact weights, and their places stored.
- dense ray tracing, against a gather of as many pixel values as all views have pairs, without weights.
- one correlation pass, against the bare `scipy.fft` of its windows: two forward and one inverse transform each.

Writes limits.json beside this file and prints a table.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from numba import njit, prange
from scene import DEPTH_MM, LATERAL_MM, Scene
from scipy import fft

from plenopiv.displacement.multigrid import correlation_pass
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.windows import window_grid
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import most_light
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.thinning import keeping
from plenopiv.volume import SparseVolume

sys.path.append(str(Path(__file__).parents[1] / "reconstruction"))
from pixel_sequential import shares

SCENE = Scene((300, 200, 260), (LATERAL_MM, LATERAL_MM, DEPTH_MM))  # as deep as the paper's full size
VIEWS = 4  # at once, as MART takes them
LISTED = (1.0, 0.2, 0.02)
WINDOW = (16, 64, 64)


def best(work: Callable[[], object], times: int = 5) -> float:
    """Least seconds of several runs; the first, which may compile, does not count."""
    work()
    seconds = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


@njit(parallel=True, fastmath=True, error_model="numpy")
def gather(start, lens, weight, image, out):
    """out[v] = sum of weight * image[lens] over the pairs of voxel v."""
    for v in prange(out.size):
        total = np.float32(0)
        for n in range(start[v], start[v + 1]):
            total += weight[n] * image[lens[n]]
        out[v] = total


@njit(parallel=True, fastmath=True, error_model="numpy")
def scatter(start, lens, weight, values, images):
    """images[lens] += weight * value over the pairs of each voxel; one image a thread."""
    threads, count = images.shape[0], values.size
    for t in prange(threads):
        images[t] = np.float32(0)
        for v in range(count * t // threads, count * (t + 1) // threads):
            for n in range(start[v], start[v + 1]):
                images[t, lens[n]] += weight[n] * values[v]


@njit(parallel=True, fastmath=True, error_model="numpy")
def gather_pixels(lens, image, passes):
    """Nothing but reads of ``image`` at stored places, ``passes`` times over."""
    chunks = 64
    out = np.zeros(chunks, np.float32)
    for c in prange(chunks):
        total = np.float32(0)
        for _ in range(passes):
            for n in range(lens.size * c // chunks, lens.size * (c + 1) // chunks):
                total += image[lens[n]]
        out[c] = total
    return out.sum()


def listed(share: float) -> SparseVolume:
    """A random share of the scene's voxels."""
    rng = np.random.default_rng(0)
    every = SCENE.projector.every_voxel()
    volume = every if share == 1 else keeping(every, rng.random(every.values.size) < share)
    return volume.with_values(rng.random(volume.values.size).astype(np.float32))


class StoredPairs:
    """Indices and weights of ``views`` as rows of voxels; probed on a list of voxels short enough to be stored."""

    def __init__(self, volume: SparseVolume, views: np.ndarray) -> None:
        self.views = [
            m.tocsr()
            for m in shares(PlenopticProjector(SCENE.lightfield.layout, SCENE.grid, "polygons"), volume, views)
        ]  # type: ignore[call-arg]
        self.pairs = sum(m.nnz for m in self.views)
        self.images = np.zeros((numba.get_num_threads(), SCENE.projector.layout.lenses), np.float32)

    def gather(self, image: np.ndarray, out: np.ndarray) -> None:
        """One view after the other."""
        for m in self.views:
            gather(m.indptr, m.indices, m.data, image, out)

    def scatter(self, values: np.ndarray) -> None:
        """One view after the other."""
        for m in self.views:
            scatter(m.indptr, m.indices, m.data, values, self.images)
            self.images.sum(0)


def projections() -> list[dict]:
    """Forward and back at several shares of listed voxels."""
    projector, rows = SCENE.projector, []
    views = projector.whole_views[:: projector.whole_views.size // VIEWS][:VIEWS]
    images = np.random.default_rng(1).random((views.size, projector.layout.lenses)).astype(np.float32)
    for share in LISTED:
        volume = listed(share)
        sample = volume if share <= 0.2 else listed(0.2)  # all pairs of all voxels would take 20 GB
        stored, scale = StoredPairs(sample, views), volume.values.size / sample.values.size
        out = np.empty(sample.values.size, np.float32)
        rows.append(
            {
                "listed": share,
                "voxels": volume.values.size,
                "pairs a voxel and view": stored.pairs / sample.values.size / views.size,
                "forward": best(lambda v=volume: projector.forward(views, v)),
                "scatter limit": scale * best(lambda s=stored, v=sample: s.scatter(v.values)),
                "back": best(lambda v=volume: projector.gather(views, images, v)),
                "gather limit": scale * best(lambda s=stored, o=out: s.gather(images[0], o)),
            }
        )
        del stored
    return rows


def ray_tracing(pairs_a_voxel: float) -> dict:
    """DRT on the scene's frame, and a gather of as many pixels."""
    lightfield, projector = SCENE.lightfield, SCENE.projector
    noise = Noise(dark_noise(lightfield), 0.5)
    found = reconstruct(lightfield.values, projector, ReconstructionSettings(iterations=1))
    bound, light = most_light(lightfield, noise), found.threshold / projector.light_in_focus
    seconds = best(lambda: projector.candidates(bound, light), 2)
    places = np.sort(np.random.default_rng(2).integers(0, projector.layout.lenses, 1 << 22)).astype(np.int32)
    pairs = pairs_a_voxel * SCENE.grid.size * projector.views
    passes = 32
    limit = best(lambda: gather_pixels(places, lightfield.values[0], passes), 2) * pairs / (places.size * passes)
    return {"drt": seconds, "gather limit": limit, "pairs": pairs, "left": found.candidates}


def correlation() -> dict:
    """A pass with deformation on two reconstructions of the scene, and the bare transforms of its windows."""
    volumes = [
        reconstruct(SCENE.lightfield.values, SCENE.projector, ReconstructionSettings(iterations=2, seed=s)).volume
        for s in (0, 1)
    ]
    settings, grid = CorrelationSettings(), window_grid(SCENE.grid.shape, WINDOW, 0.5)
    predictor = fit_spline(np.full((3, *grid.shape), 0.3), grid.centres, SCENE.grid.shape)
    seconds = best(lambda: correlation_pass(*volumes, grid, predictor, settings, settings.residual_search), 3)
    count = int(np.prod(grid.shape))
    batch = np.random.default_rng(0).random((16, *WINDOW)).astype(np.float32)
    spectrum = fft.rfftn(batch, axes=(1, 2, 3))

    def bare() -> None:
        threads = numba.get_num_threads()
        for _ in range(2):
            fft.rfftn(batch, axes=(1, 2, 3), workers=threads)
        fft.irfftn(spectrum, WINDOW, axes=(1, 2, 3), workers=threads)

    return {"windows": count, "pass": seconds, "bare FFTs": best(bare) * count / len(batch)}


def main() -> None:
    """Measure, print, write."""
    rows = projections()
    found = {"threads": numba.get_num_threads(), "projections": rows}
    print(
        "| listed, % | pairs a voxel and view | forward, ms a view | limit | share | back, ms a view | limit | share |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|---:|")
    for r in rows:
        f, s, b, g = (1e3 * r[k] / VIEWS for k in ("forward", "scatter limit", "back", "gather limit"))
        row = f"| {100 * r['listed']:g} | {r['pairs a voxel and view']:.1f} | {f:.1f} | {s:.1f} | {s / f:.0%} "
        print(row + f"| {b:.1f} | {g:.1f} | {g / b:.0%} |")
    drt = ray_tracing(rows[1]["pairs a voxel and view"])
    found["ray tracing"] = drt
    print(f"\nDRT {drt['drt']:.2f} s, a gather of its {drt['pairs']:.1e} pixels {drt['gather limit']:.2f} s")
    found["correlation"] = c = correlation()
    print(
        f"Correlation pass {c['pass']:.2f} s, bare FFTs {c['bare FFTs']:.2f} s: {c['pass'] / c['bare FFTs']:.2f} times"
    )
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
