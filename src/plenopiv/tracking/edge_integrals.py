"""Integrals along straight edges of evenly lit patches, node by node, into the pixels about them.

Lengths are pixels. k is a pixel's square of width 1 convolved with a Gaussian, K its integral; with n the outer normal
an edge gives  K(X - column) k(Y - row) n_x ds  to the share of a pixel and  k k (velocity . n) ds  to its change.
"""

from __future__ import annotations

from math import ceil, floor, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from plenopiv.kernels import part

PIECE = 0.4  # px between two sets of nodes: gradients are exact to half a percent for diffraction of 0.16 px
NODES = 3
ROOT = sqrt(0.6)  # Gauss-Legendre of three nodes on -1 ... 1
SHORT = 0.25  # px: so short a piece has two nodes, as exact
ROOT_OF_TWO = 1.0 / sqrt(3.0)  # Gauss-Legendre of two nodes
PER_PX = 256  # entries of the table of k and K
TAIL = 4.0  # standard deviations of diffraction that the table reaches beyond the pixel
EDGE = 2.5  # standard deviations beyond its edges at which a patch ends: 1e-5 of the light is left out

Array = NDArray[np.float64]


def pixel_profile(blur_px: float) -> NDArray[np.float32]:
    """k, its integral K, and what both grow by to the next entry, on -tail ... tail, ``PER_PX`` entries a pixel."""
    tail = 0.5 + TAIL * blur_px
    at = np.arange(ceil(2 * tail * PER_PX) + 2) / PER_PX - tail

    def normal(x: Array) -> Array:
        return 0.5 * (1.0 + np.asarray(erf(x / sqrt(2.0))))

    def twice(x: Array) -> Array:  # integral of the normal distribution's integral
        return x * normal(x) + np.exp(-0.5 * x * x) / sqrt(2.0 * pi)

    above, below = (at + 0.5) / blur_px, (at - 0.5) / blur_px
    values = np.stack([normal(above) - normal(below), blur_px * (twice(above) - twice(below))], -1)
    return np.concatenate([values, np.diff(values, axis=0, append=values[-1:])], -1).astype(np.float32)


@part
def at_node(
    tail_px: float,  # half width of k
    table: NDArray[np.float32],  # (n, 4): k, K, and what they grow by to the next entry
    x: float, y: float,  # of the node, pixels from the middle of the patch's first pixel
    rows: int, columns: int,
    of_share: float, gx: float, gy: float, gz: float,  # what multiplies K k, and k k
    column: NDArray[np.float32],  # (4 columns,) to work in
    patch: NDArray[np.float32],  # (rows, 4 columns): share and gradient of each pixel, added to
) -> None:  # fmt: skip
    """Add a node of the boundary to the pixels of a patch."""
    last = table.shape[0] - 2
    along = np.float32((x + tail_px) * PER_PX)
    by_k, by_x, by_y, by_z = np.float32(of_share), np.float32(gx), np.float32(gy), np.float32(gz)
    for c in range(columns):
        at = min(max(along - np.float32(PER_PX * c), np.float32(0.0)), np.float32(last))
        i = np.uint32(at)
        rest = at - np.float32(i)
        k = table[i, 0] + rest * table[i, 2]
        column[4 * c] = by_k * (table[i, 1] + rest * table[i, 3])
        column[4 * c + 1] = by_x * k
        column[4 * c + 2] = by_y * k
        column[4 * c + 3] = by_z * k
    for r in range(max(ceil(y - tail_px), 0), min(floor(y + tail_px) + 1, rows)):
        at = min(max(np.float32((y - r + tail_px) * PER_PX), np.float32(0.0)), np.float32(last))
        i = np.uint32(at)
        ky = table[i, 0] + (at - np.float32(i)) * table[i, 2]
        row = np.uint64(r)
        for q in range(4 * columns):
            patch[row, q] += ky * column[q]


@part
def nodes_of(length: float) -> int:
    """How many nodes a straight edge, or an arc, has."""
    return 2 if length <= SHORT else NODES * ceil(length / PIECE)


@part
def node_of(node: int, count: int, length: float) -> tuple[float, float]:
    """Where on an edge of so many nodes one of them is, 0 to 1, and what length it stands for."""
    if count == 2:
        return 0.5 + (node - 0.5) * ROOT_OF_TWO, 0.5 * length
    parts, of_three = count // NODES, node % NODES
    middle = (node // NODES + 0.5 + 0.5 * ROOT * (of_three - 1)) / parts
    return middle, length / parts * (4.0 / 9.0 if of_three == 1 else 5.0 / 18.0)
