"""Volumes of Gaussian particles whose displacement is known."""

import numpy as np

from plenopiv.volume import DenseVolume, VoxelGrid


def render(shape, positions, brightness, sigma):
    """Gaussians of ``sigma`` (x, y, z) at ``positions`` (n, 3) in voxel indices (x, y, z)."""
    out = np.zeros(shape, np.float32)
    for position, light in zip(positions, brightness, strict=True):
        cut, factors = [], []
        for centre, width, n in zip(position[::-1], sigma[::-1], shape, strict=True):
            reach = int(np.ceil(5 * width + 1))
            k = np.arange(max(0, round(centre) - reach), min(n, round(centre) + reach + 1))
            cut.append(slice(k[0], k[-1] + 1) if k.size else slice(0, 0))
            factors.append(np.exp(-0.5 * ((k - centre) / width) ** 2))
        z, y, x = factors
        out[tuple(cut)] += (light * z[:, None, None] * y[:, None] * x).astype(np.float32)
    return out


def particle_pair(shape, flow, density, sigma=(1.0, 1.0, 1.0), seed=0, lost=0.0, ghosts=0.0, jitter=(0.0, 0.0, 0.0)):
    """Two volumes; ``flow`` maps (n, 3) mid-time positions x, y, z to displacements."""
    rng = np.random.default_rng(seed)
    margin, size = 12, np.array(shape[::-1])
    n = rng.poisson(density * np.prod(size + 2 * margin))
    middle = rng.uniform(-margin, size - 1 + margin, (n, 3))
    light = np.exp(0.3 * rng.standard_normal(n))
    moved, volumes = np.asarray(flow(middle), float), []
    for side in (-0.5, 0.5):
        seen = rng.random(n) >= lost / 2
        at = (middle + side * moved)[seen] + rng.standard_normal((seen.sum(), 3)) * jitter
        ghost = rng.uniform(-margin, size - 1 + margin, (int(ghosts * n), 3))
        both = np.concatenate([light[seen], 0.6 * np.exp(0.3 * rng.standard_normal(len(ghost)))])
        values = render(shape, np.concatenate([at, ghost]), both, sigma)
        volumes.append(DenseVolume(VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), shape), values))
    return volumes
