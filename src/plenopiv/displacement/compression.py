"""Intensities as they are correlated: blended with those beside them, and raised to a power.

Correlation weighs a particle by the square of its brightness; of square roots many moderate particles count instead of
a few bright ones. A square root also raises what is faint: the voxels at a particle's rim, which reconstructions draw
with a share of chance, and it does so more or less by where the particle lies between voxels, which pulls displacements
toward whole ones. Both are less in intensities that are blended first, along x and y, with

    (1/8, 3/4, 1/8)

which widens a particle by a quarter of a voxel^2; at the faces of the volume a voxel stands for its missing neighbour,
so that even light stays even. docs/decisions/0061 has the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel
from plenopiv.threads import in_threads
from plenopiv.volume import Volume, VoxelGrid

BESIDE = 0.125  # share of its intensity that a voxel gives to each of two neighbours along an axis


@dataclass(frozen=True)
class CompressedVolume:
    """A ``volume`` as it is correlated, made plane by plane as it is asked for: intensities are blended and raised to
    the power ``exponent``, negative ones as none, unless that is 1, then multiplied by ``factor``."""

    volume: Volume
    exponent: float = 1.0
    factor: float = 1.0

    @property
    def grid(self) -> VoxelGrid:
        """Where its voxels are."""
        return self.volume.grid

    @property
    def values(self) -> NDArray[np.float32]:
        """Intensity of the voxels that the volume holds, were they not blended."""
        values = self.volume.values
        if self.exponent != 1.0:
            values = np.maximum(values, np.float32(0.0))
            values = np.sqrt(values) if self.exponent == 0.5 else values ** np.float32(self.exponent)
        return values * np.float32(self.factor)

    def slab(self, lo: int, hi: int) -> NDArray[np.float32]:
        """See ``Volume.slab``."""
        planes = self.volume.slab(lo, hi)
        if self.exponent != 1.0:
            out = np.empty(planes.shape, np.float32)
            in_threads(_blend_and_raise, len(planes), planes, np.float32(self.exponent), out)
            planes = out
        return planes if self.factor == 1.0 else planes * np.float32(self.factor)


def compressed(volume: Volume, exponent: float) -> Volume:
    """The volume as it is correlated; ``exponent`` 1 leaves it as it is."""
    return volume if exponent == 1.0 else CompressedVolume(volume, exponent)


@kernel
def _blend_and_raise(
    begin: int, end: int, planes: NDArray[np.float32], exponent: np.float32, out: NDArray[np.float32]
) -> None:
    """Planes ``begin`` to ``end`` (nz, ny, nx), blended with their neighbours along x and y, to the power."""
    _, ny, nx = planes.shape
    beside, none = np.float32(BESIDE), np.float32(0)
    own = np.float32(1) - beside - beside
    along_x, lit = np.zeros((ny + 2, nx), np.float32), np.zeros(ny + 2, np.uint8)
    row = np.zeros(nx + 2, np.float32)
    for k in range(begin, end):
        for j in range(ny):
            light = none
            for i in range(nx):
                row[i + 1] = max(planes[k, j, i], none)
                light += row[i + 1]
            lit[j + 1] = light > none
            if lit[j + 1]:
                row[0], row[nx + 1] = row[1], row[nx]
                for i in range(nx):
                    along_x[j + 1, i] = own * row[i + 1] + beside * (row[i] + row[i + 2])
        along_x[0], along_x[ny + 1] = along_x[1], along_x[ny]
        lit[0], lit[ny + 1] = lit[1], lit[ny]
        for j in range(ny):
            if not (lit[j] or lit[j + 1] or lit[j + 2]):
                out[k, j] = none
                continue
            for n in range(3):
                if not lit[j + n]:
                    along_x[j + n] = none
            before, here, after, to = along_x[j], along_x[j + 1], along_x[j + 2], out[k, j]
            for i in range(nx):
                to[i] = own * here[i] + beside * (before[i] + after[i])
            if exponent == np.float32(0.5):
                for i in range(nx):
                    to[i] = np.sqrt(to[i])
            else:
                for i in range(nx):
                    to[i] = to[i] ** exponent if to[i] > none else none
