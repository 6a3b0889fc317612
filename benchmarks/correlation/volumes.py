"""Pairs of volumes of Gaussian particles whose displacement is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

SIGMA = 1.0  # voxel
WINDOW = 32
PARTICLES_A_WINDOW = 10
BRIGHTNESS_SPREAD = 0.3  # standard deviation of the logarithm
_MARGIN = 12  # voxels around the volume from which particles may come or reach in

Shape = tuple[int, int, int]
Flow = Callable[[NDArray], NDArray]  # (n, 3) mid-time positions x, y, z to (n, 3) displacements, voxels


def particle_pair(shape: Shape, flow: Flow, rng: np.random.Generator, lost: float = 0.0, ghosts: float = 0.0):
    """Two float32 volumes ``shape`` (nz, ny, nx), half a displacement before and after mid-time.

    ``lost``: share of the particles that only one of the two volumes shows, each volume missing half of them.
    ``ghosts``: blobs at random places, others in each volume and as bright as particles, as a share of their number.
    """
    low, high = np.full(3, -0.5 - _MARGIN), np.array(shape[::-1]) - 0.5 + _MARGIN
    count = rng.poisson(PARTICLES_A_WINDOW / WINDOW**3 * np.prod(high - low))
    middle, light, fate = rng.uniform(low, high, (count, 3)), brightness(rng, count), rng.random(count)
    moved = flow(middle)
    pair = []
    for side, seen in ((-0.5, fate >= lost / 2), (0.5, fate < 1 - lost / 2)):
        extra = rng.poisson(ghosts * count)
        at = np.concatenate([(middle + side * moved)[seen], rng.uniform(low, high, (extra, 3))])
        pair.append(rendered(shape, at, np.concatenate([light[seen], brightness(rng, extra)])))
    return pair


def brightness(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return np.exp(BRIGHTNESS_SPREAD * rng.standard_normal(count))


def rendered(shape: Shape, positions: NDArray, light: NDArray) -> NDArray[np.float32]:
    """Gaussians of ``SIGMA`` at ``positions`` (n, 3), voxel indices x, y, z, sampled at the voxel centres."""
    out = np.zeros(shape, np.float32)
    reach = int(np.ceil(5 * SIGMA)) + 1
    for position, bright in zip(positions, light, strict=True):
        cut, factors = [], []
        for centre, n in zip(position[::-1], shape, strict=True):
            k = np.arange(max(0, round(centre) - reach), min(n, round(centre) + reach + 1))
            cut.append(slice(k[0], k[-1] + 1) if k.size else slice(0, 0))
            factors.append(np.exp(-0.5 * ((k - centre) / SIGMA) ** 2))
        z, y, x = factors
        out[tuple(cut)] += (bright * z[:, None, None] * y[:, None] * x).astype(np.float32)
    return out
