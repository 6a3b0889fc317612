"""Isosurfaces of a field on a regular grid, by marching tetrahedra (Doi & Koide 1991)."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Six tetrahedra of a cell, each along a path of three edges from its low to its high corner (Kuhn).
TETRAHEDRA = [np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(way)]], axis=0) for way in permutations(range(3))]


def isosurface(values: Array, level: float, axes: tuple[Array, Array, Array]) -> Array:
    """Triangles (n, 3 corners, 3) as x, y, z where ``values`` (nz, ny, nx), linear in tetrahedra, cross ``level``.

    ``axes``: coordinates along x, y, z. Seen from where values are lower, corners run counter-clockwise.
    """
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    places = np.stack([x, y, z], -1)
    found = [np.empty((0, 3, 3))]
    for tetrahedron in TETRAHEDRA:
        corners = [
            tuple(slice(s, n - 1 + s) for s, n in zip(shift, values.shape, strict=True)) for shift in tetrahedron
        ]
        height = np.stack([values[c].ravel() for c in corners], -1) - level
        crossing = (height > 0).any(1) & (height <= 0).any(1)
        order = np.argsort(-height[crossing], axis=1)  # those above first
        height = np.take_along_axis(height[crossing], order, 1)
        at = np.stack([places[c].reshape(-1, 3) for c in corners], 1)[crossing]
        at = np.take_along_axis(at, order[:, :, None], 1)
        above = (height > 0).sum(1)
        for count, faces in ((1, ["010203"]), (2, ["020313", "021213"]), (3, ["031323"])):
            here = above == count
            found += [_triangles(height[here], at[here], face) for face in faces]
    return np.concatenate(found)


def _triangles(height: Array, at: Array, face: str) -> Array:
    """A triangle of each tetrahedron whose corners lie on three of its edges, "010203" those from 0 to 1, 2 and 3."""
    points = []
    for a, b in zip(map(int, face[::2]), map(int, face[1::2]), strict=True):
        share = (height[:, a] / (height[:, a] - height[:, b]))[:, None]
        points.append(at[:, a] + share * (at[:, b] - at[:, a]))
    triangle = np.stack(points, 1)
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    inward = ((at[:, 3] - at[:, 0]) * normal).sum(1) < 0  # from the highest corner to the lowest
    triangle[inward] = triangle[inward][:, ::-1]
    return triangle
