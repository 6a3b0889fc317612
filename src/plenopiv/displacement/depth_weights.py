"""How much light counts in the correlation by its depth, without a pull on displacements.

A weight that is fixed in space bends the profile of a particle that is long in depth: where the weight rises, it shows
more of the far side. In both volumes alike, wherever the particle is, so that its two images lie nearer to each other
than it moved; of a weight z^2 and a Gaussian of standard deviation s, by 1/(1 + 2 s^2/z^2). Weights are therefore those
of the *deformed* windows, where the images of a particle coincide, the same for both:

    g(z) = sqrt(g(z - d/2) g(z + d/2))

with d the displacement in depth at the window's centre. They shift no peak, and light counts little where it is in
either volume at a depth of little weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class DepthWeights:
    """``values`` (nz, rows, columns), above 0: of each plane of voxels, at the places ``y`` (rows,) and ``x``
    (columns,) in voxels, ascending; linear between them, beyond them as at the outermost."""

    values: NDArray[np.float32]
    y: NDArray[np.float64]
    x: NDArray[np.float64]

    def slab(self, lo: int, hi: int, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Of planes ``lo`` <= k < ``hi`` of the volume with ``shape`` (ny, nx): (hi - lo, ny, nx), or (hi - lo, 1, 1)
        where all of a plane count alike."""
        if self.values[0].size == 1:
            return self.values[lo:hi]
        ny, nx = shape
        along_x = np.einsum("krc,xc->krx", self.values[lo:hi], _between(np.arange(nx), self.x))
        return np.einsum("krx,yr->kyx", along_x, _between(np.arange(ny), self.y)).astype(np.float32)

    def weighed(self, planes: NDArray[np.float32], lo: int) -> NDArray[np.float32]:
        """``planes`` (n, ny, nx) of a volume from plane ``lo`` on, times their weights; one plane of these at a time is
        in memory."""
        out = np.empty_like(planes)
        for k, plane in enumerate(planes):
            np.multiply(plane, self.slab(lo + k, lo + k + 1, plane.shape)[0], out=out[k])
        return out

    def of_windows(
        self, first: int, depth: int, centres: NDArray[np.float64], moved: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Of the planes ``first`` to ``first + depth`` of windows whose ``centres`` (n, 2) are at y, x voxels, and
        whose light ``moved`` (n,) voxels in depth between the volumes: (n, depth)."""
        reach = int(np.abs(moved).max(initial=0.0) / 2) + 1  # planes beyond the window
        lo, hi = max(first - reach, 0), min(first + depth + reach, len(self.values))
        if self.values[0].size == 1:
            of_each = np.broadcast_to(self.values[lo:hi, 0, 0], (len(centres), hi - lo))
        else:
            shares = _between(centres[:, 0], self.y), _between(centres[:, 1], self.x)
            of_each = np.einsum("nr,nc,krc->nk", *shares, self.values[lo:hi])
        out, last = np.ones((len(centres), depth)), hi - lo - 1
        for side in (-0.5, 0.5):
            place = np.clip(first - lo + np.arange(depth) + side * moved[:, None], 0, last)
            below = place.astype(np.int64)
            above = np.minimum(below + 1, last)
            here = np.take_along_axis(of_each, below, 1)
            out *= here + (place - below) * (np.take_along_axis(of_each, above, 1) - here)
        return np.sqrt(out).astype(np.float32)


def _between(at: NDArray, knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares (n, knots) of a linear interpolation at each of ``at`` (n,)."""
    out = np.zeros((len(at), len(knots)))
    if len(knots) == 1:
        return out + 1.0
    place = np.clip(np.interp(at, knots, np.arange(len(knots))), 0, len(knots) - 1)
    below = np.minimum(place.astype(np.int64), len(knots) - 2)
    rows = np.arange(len(at))
    out[rows, below] = below + 1 - place
    out[rows, below + 1] = place - below
    return out
