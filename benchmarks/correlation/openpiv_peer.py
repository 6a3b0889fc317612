"""OpenPIV's 3D correlation, one pair of volumes after another. Runs in an environment of its own; run.py starts it.

First line out: OpenPIV's version. Then for each line in, a folder with a.npy and b.npy (nz, ny, nx), one line out: the
CPU-seconds of the correlation; displacements are in the folder's d.npy (3, windows z, y, x): components x, y, z.
"""

import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
from openpiv.pyprocess3D import extended_search_area_piv3D


def displacement(a, b, size, step):
    """Displacements along x, y, z. For frames of axes 0, 1, 2 OpenPIV returns u = -d1, v = +d0, w = +d2."""
    window, overlap = (size,) * 3, (size - step,) * 3
    minus_y, z, x = extended_search_area_piv3D(a, b, window, overlap, search_area_size=window)
    return np.stack([x, -minus_y, z])


def check_signs():
    """One blob that moves by (1, 2, 3) voxels along x, y, z must be found to do so."""
    k = np.arange(32.0)
    a, b = (
        np.einsum("k,j,i->kji", *(np.exp(-0.5 * (k - 16 - side * d) ** 2) for d in (3, 2, 1))) for side in (0.0, 1.0)
    )
    found = displacement(a, b, 32, 16)[:, 0, 0, 0]
    if not np.allclose(found, (1, 2, 3), atol=0.1):
        raise SystemExit(f"OpenPIV finds {found} for a displacement of 1, 2, 3: its order or signs have changed")


def main():
    size, step = map(int, sys.argv[1:])
    check_signs()
    print(version("openpiv"), flush=True)
    for line in sys.stdin:
        folder = Path(line.strip())
        a, b = np.load(folder / "a.npy"), np.load(folder / "b.npy")
        begin = time.process_time()
        found = displacement(a, b, size, step)
        seconds = time.process_time() - begin
        np.save(folder / "d.npy", found)
        print(seconds, flush=True)


if __name__ == "__main__":
    main()
