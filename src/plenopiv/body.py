"""A solid body in the flow, a closed surface of triangles, and the places that lie in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, brief

AT_A_TIME = 1 << 21  # pairs of a triangle and a column of places

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """A closed surface in the object frame: corners of its ``triangles`` (n, 3, 3) in mm, x, y, z last."""

    triangles: Array

    @property
    def limits_mm(self) -> tuple[Array, Array]:
        """Its lowest and its highest x, y, z."""
        return self.triangles.min((0, 1)), self.triangles.max((0, 1))

    def holds(self, x_mm: Array, y_mm: Array, z_mm: Array) -> NDArray[np.bool_]:
        """Whether the places of a grid, ascending along each axis, lie in it: (nz, ny, nx).

        Along a line parallel to z a place is inside where the surface was crossed an odd number of times. Which side of
        an edge a line passes is decided once for both triangles that share the edge, so that none is crossed twice or
        not at all.
        """
        flips = np.zeros((z_mm.size + 1, y_mm.size, x_mm.size), bool)
        first, last = self.triangles.min(1), self.triangles.max(1)
        i, j = (np.searchsorted(axis, first[:, k]) for k, axis in enumerate((x_mm, y_mm)))
        across, along = (
            np.searchsorted(axis, last[:, k], "right") - begin for k, (axis, begin) in enumerate(((x_mm, i), (y_mm, j)))
        )
        count = across * along  # columns that a triangle may meet
        upto = np.cumsum(count)
        begin = 0
        while begin < len(count):
            done = upto[begin - 1] if begin else 0
            end = max(int(np.searchsorted(upto, done + AT_A_TIME, "right")), begin + 1)
            which = np.repeat(np.arange(begin, end), count[begin:end])
            number = np.arange(which.size) - np.repeat(upto[begin:end] - count[begin:end] - done, count[begin:end])
            row, column = np.divmod(number, np.maximum(across[which], 1))
            row, column = row + j[which], column + i[which]
            met, z = _crossings(self.triangles[which], x_mm[column], y_mm[row])
            place = np.searchsorted(z_mm, z[met], "right"), row[met], column[met]
            np.logical_xor.at(flips, place, True)
            begin = end
        return np.logical_xor.accumulate(flips, 0)[:-1]


def _crossings(triangles: Array, x: Array, y: Array) -> tuple[NDArray[np.bool_], Array]:
    """Whether lines parallel to z at (x, y) cross each its triangle (n, 3, 3), and where along z."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    left = sum(_left(p, q, x, y).astype(np.int8) for p, q in ((a, b), (b, c), (c, a)))
    met = np.isin(left, (0, 3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    dx, dy = x - a[:, 0], y - a[:, 1]
    safe = np.where(area == 0, 1.0, area)  # a triangle seen from its edge is met by rounding alone
    s, t = (dx * v[:, 1] - dy * v[:, 0]) / safe, (dy * u[:, 0] - dx * u[:, 1]) / safe
    return met, a[:, 2] + np.clip(s, 0, 1) * u[:, 2] + np.clip(t, 0, 1) * v[:, 2]


def _left(p: Array, q: Array, x: Array, y: Array) -> NDArray[np.bool_]:
    """Whether (x, y) is to the left of the edge from p to q: the opposite from q to p, to the last bit."""
    turned = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
    low, high = np.where(turned[:, None], q, p), np.where(turned[:, None], p, q)
    cross = (high[:, 0] - low[:, 0]) * (y - low[:, 1]) - (high[:, 1] - low[:, 1]) * (x - low[:, 0])
    return (cross >= 0) ^ turned


def read_body(path: Path) -> Body:
    """The body of an STL file, in mm.

    Raises:
        PlenoPIVError: missing, no STL file, damaged, or its surface is not closed.
    """
    import trimesh

    if path.suffix.lower() != ".stl":
        raise PlenoPIVError(f"{path}: volume.body is read from STL files; export it as one, in mm")
    try:
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type="stl")
            triangles, closed = np.asarray(mesh.triangles, float), bool(mesh.is_watertight)
    except FileNotFoundError:
        raise PlenoPIVError(f"{path}: no such file (volume.body)") from None
    except (OSError, ValueError) as error:
        raise PlenoPIVError(f"{path}: cannot be read ({brief(error)})") from None
    except Exception as error:  # what a damaged file makes of its reader
        raise PlenoPIVError(f"{path}: is no STL file, or a damaged one ({brief(error)})") from None
    if triangles.size == 0 or not np.isfinite(triangles).all():
        raise PlenoPIVError(f"{path}: holds no surface of finite numbers; export the body again, as STL in mm")
    if not closed:
        raise PlenoPIVError(
            f"{path}: its surface is not closed, so that it has no inside; close its holes where it was drawn, and "
            "export it again"
        )
    return Body(triangles)
