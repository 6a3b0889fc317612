"""Peers of the reconstruction, run by peers.py in an environment of their own:  reconstruction_peer.py METHOD FOLDER N

N iterations of "mart" (scipy.sparse), "sirt" (ASTRA) or "richardson-lucy" (pyolaf) on what lies in FOLDER. Prints
seconds, GB at the peak and the residual in counts.
"""

import contextlib
import io
import sys
import time
from pathlib import Path

import numpy as np
from scipy import sparse

RELAXATION = 0.25
FLOOR = 1.0  # counts
REPEATS = 3  # of which the least counts, as of this project's


def weights(folder):
    parts = (np.load(folder / f"{name}.npy") for name in ("data", "indices", "indptr"))
    data, indices, indptr = parts
    light = np.load(folder / "light.npy")
    return data, indices, indptr, light


def mart(folder, rounds):
    """Each view's pixels at once, one view after the other in a random order, as this project's MART has them."""
    data, indices, indptr, light = weights(folder)
    measured = np.load(folder / "measured.npy")
    views, lenses = measured.shape
    of_view = []
    for v in range(views):
        begin = indptr[v * lenses : (v + 1) * lenses + 1]
        part = slice(begin[0], begin[-1])
        of_view.append(
            sparse.csr_matrix((data[part], indices[part], begin - begin[0]), (lenses, light.size), copy=False)
        )
    taken = []
    for _ in range(REPEATS):
        rng = np.random.default_rng(0)
        begin = time.perf_counter()
        volume = np.full(light.size, max(measured.sum(), 1.0) / light.size, np.float32)
        for _ in range(rounds):
            for v in rng.permutation(views):
                projected = of_view[v] @ volume
                ratio = (np.maximum(measured[v], 0) + FLOOR) / (projected + FLOOR)
                volume *= np.maximum(1 + (of_view[v].T @ (ratio**RELAXATION - 1)) / light, 0)
        taken.append(time.perf_counter() - begin)
    seconds = min(taken)
    left = np.concatenate([m @ volume for m in of_view]).reshape(measured.shape) - measured
    return seconds, np.sqrt(np.mean(left[np.load(folder / "seen.npy")] ** 2))


def sirt(folder, rounds):
    """ASTRA's SIRT on the CPU with a sparse matrix for a projector, light >= 0."""
    import astra

    data, indices, indptr, light = weights(folder)
    measured = np.load(folder / "measured.npy")
    views, lenses = measured.shape
    matrix = astra.matrix.create(sparse.csr_matrix((data, indices, indptr), (views * lenses, light.size), copy=False))
    of_volume = astra.create_vol_geom(1, light.size)
    of_images = astra.create_proj_geom("sparse_matrix", 1.0, lenses, np.zeros(views), matrix)
    projector = astra.create_projector("sparse_matrix", of_images, of_volume)
    volume, images = astra.data2d.create("-vol", of_volume, 0.0), astra.data2d.create("-sino", of_images, measured)
    settings = astra.astra_dict("SIRT")
    settings |= {"ProjectorId": projector, "ReconstructionDataId": volume, "ProjectionDataId": images}
    settings["option"] = {"UseMinConstraint": "yes", "MinConstraintValue": 0.0}
    taken = []
    for _ in range(REPEATS):
        astra.data2d.store(volume, 0.0)
        algorithm = astra.algorithm.create(settings)
        begin = time.perf_counter()
        astra.algorithm.run(algorithm, rounds)
        taken.append(time.perf_counter() - begin)
    seconds = min(taken)
    stored = sparse.csr_matrix((data, indices, indptr), (views * lenses, light.size), copy=False)
    left = (stored @ astra.data2d.get_shared(volume).ravel()).reshape(measured.shape) - measured
    return seconds, np.sqrt(np.mean(left[np.load(folder / "seen.npy")] ** 2))


def richardson_lucy(folder, rounds):
    """pyolaf's projections back and forth, voxels a pixel wide."""
    from pyolaf.project import LFM_backwardProject, LFM_forwardProject

    patterns, measured = np.load(folder / "patterns.npy"), np.load(folder / "measured.npy")
    planes, n, _, side, _ = patterns.shape
    half, lenses = n // 2, side // n
    forward, back = np.empty((n, n, planes), object), np.empty((n, n, planes), object)
    columns = n * (np.arange(lenses) - lenses // 2)
    centres = np.stack(np.meshgrid(columns, columns, indexing="ij"), -1).astype(float)
    # a pattern's middle is the voxel itself; back, that of a pixel holds the voxels that light it
    reach = side - n
    rows, cols = np.mgrid[-(reach // 2) : reach // 2 + 1, -(reach // 2) : reach // 2 + 1]
    middle = side // 2
    for k in range(planes):
        for j in range(n):
            for i in range(n):
                about = np.roll(patterns[k, j, i], (half - j, half - i), (0, 1))
                forward[j, i, k] = sparse.csr_matrix(about[middle + rows, middle + cols])
        for j in range(n):
            for i in range(n):
                by_y, by_x = (j + rows) % n, (i + cols) % n
                y, x = middle - rows + (by_y - half), middle - cols + (by_x - half)
                inside = (y >= 0) & (y < side) & (x >= 0) & (x < side)
                found = np.where(inside, patterns[k, by_y, by_x, y.clip(0, side - 1), x.clip(0, side - 1)], 0)
                back[j, i, k] = sparse.csr_matrix(found)
    del patterns
    about = {
        "TexNnum": np.array([n, n]), "TexNnum_half": np.array([half + 1, half + 1]), "texMask": np.ones((n, n), int),
        "Nnum": np.array([n, n]), "Nnum_half": np.array([half + 1, half + 1]), "sensMask": np.ones((n, n), int),
        "texScaleFactor": np.array([1.0, 1.0]),
    }  # fmt: skip
    about = {name: np.asarray(value) for name, value in about.items()}
    centres = {"px": centres, "vox": centres}
    size = np.array([side, side])
    with contextlib.redirect_stderr(io.StringIO()):
        volume = np.ones((side, side, planes), np.float32)
        gain = LFM_backwardProject(back, np.ones_like(measured), centres, about, size, "full")
        begin = time.perf_counter()
        for _ in range(rounds):
            projected = LFM_forwardProject(forward, volume, centres, about, size, "full")
            volume *= LFM_backwardProject(back, measured / (projected + 1e-6), centres, about, size, "full") / (
                gain + 1e-6
            )
            np.maximum(volume, 0, out=volume)
        seconds = time.perf_counter() - begin
        left = LFM_forwardProject(forward, volume, centres, about, size, "full") - measured
    return seconds, np.sqrt(np.mean(left**2))


def peak_gb():
    """Of this process alone: getrusage also counts what its parent had taken."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6


METHODS = {"mart": mart, "sirt": sirt, "richardson-lucy": richardson_lucy}

if __name__ == "__main__":
    seconds, residual = METHODS[sys.argv[1]](Path(sys.argv[2]), int(sys.argv[3]))
    print(seconds, peak_gb(), residual)
