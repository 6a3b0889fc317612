"""Discrete window offset: the displacements of the first pass refined without deformation.

Once a displacement is known to the voxel, the two windows are cut where the same particles are (Westerweel, Dabiri &
Gharib 1997, Exp. Fluids 23 20). Then only the correlation at zero residual displacement and one voxel away along each
axis is needed. Summed directly, that costs a fraction of the transforms. Each value is normalised by the spread of
the second window,

    C(d) = sum_x (a(x) - <a>) b(x + d) / sqrt(sum_x (b(x + d) - <b>)^2),

which by the Cauchy-Schwarz inequality is highest where b is a shifted. Particles cut by the windows' ends, which bias a
plain sum toward zero, cause no bias here.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numba
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.peaks import gaussian_offset
from plenopiv.displacement.windows import WindowGrid
from plenopiv.kernels import inlined, kernel, part
from plenopiv.volume import Volume

MOVES = 3  # steps of a voxel that the highest correlation may be away from the first estimate


def discrete_offset(
    a: Volume, b: Volume, windows: WindowGrid, first: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Displacements (3, nz, ny, nx) from ``a`` to ``b`` in voxels, measured between windows offset by the whole voxels
    of ``first`` (same shape), and where (nz, ny, nx) one was found.

    ``first`` is kept where no maximum is found within MOVES voxels, and where a window with a margin of one voxel does
    not fit into the volume (never, if windows fill an axis). At the volume's faces both windows are shifted inward by
    up to an eighth of their size; the vector is then that of the shifted place.
    """
    nz, ny, nx = windows.shape
    out = np.moveaxis(first, 0, -1).reshape(nz, ny * nx, 3).copy()
    found = np.zeros((nz, ny * nx), bool)
    corners = np.array(list(product(windows.starts[1].tolist(), windows.starts[2].tolist())))
    depth, planes = windows.size[0], a.grid.shape[0]
    pieces = np.array_split(np.arange(len(corners)), min(4 * numba.get_num_threads(), len(corners)))
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for layer, start in enumerate(windows.starts[0].tolist()):
            reach = min(int(np.ceil(np.abs(out[layer, :, 2]).max() / 2)), depth // 4) + MOVES
            lo, hi = max(start - reach, 0), min(start + depth + reach, planes)
            both = a.slab(lo, hi), b.slab(lo, hi)

            def work(
                part: NDArray,
                layer: int = layer,
                both: tuple[NDArray[np.float32], NDArray[np.float32]] = both,
                begin: int = start - lo,
            ) -> None:
                places = np.column_stack([np.full(len(part), begin), corners[part]])
                vectors, again = out[layer, part], found[layer, part]
                refine(*both, places, np.array(windows.size), vectors, again)
                out[layer, part], found[layer, part] = vectors, again

            list(pool.map(work, pieces))
            del both, work  # before the next layer's planes are made
    return np.moveaxis(out.reshape(nz, ny, nx, 3), -1, 0), found.reshape(nz, ny, nx)


@inlined
def product_of(one: NDArray[np.float32], two: NDArray[np.float32], begin: int, count: int) -> np.float32:
    """Sum of one[n] two[begin + n]."""
    first, second, total = one[:count], two[begin : begin + count], np.float32(0)
    for n in range(count):
        total += first[n] * second[n]
    return total


@inlined
def copied(
    b: NDArray[np.float32],
    z: int,
    y: int,
    x: int,
    size: tuple[int, int, int],
    plane: NDArray[np.float32],
    light: NDArray[np.float64],
    squares: NDArray[np.float64],
    k: int,
) -> None:
    """Copy plane k of the second window with a voxel more on each side into ``plane``; add the light of its rows, and
    its square, to those of the seven windows that hold them."""
    nz, ny, nx = size
    for j in range(-1, ny + 1):
        row, out = b[z, y + j, x - 1 : x + nx + 1], plane[(j + 1) * (nx + 2) : (j + 2) * (nx + 2)]
        s, q = np.float32(0), np.float32(0)
        for i in range(nx + 2):
            out[i] = row[i]
        for i in range(1, nx + 1):
            s += row[i]
            q += row[i] * row[i]
        if 0 <= j < ny:
            for n in range(3):
                if 0 <= k + (n == 1) - (n == 2) < nz:
                    light[n] += s
                    squares[n] += q
        if 0 <= k < nz:
            for n in range(3, 5):
                if 0 <= j + (n == 3) - (n == 4) < ny:
                    light[n] += s
                    squares[n] += q
            if 0 <= j < ny:
                first, second, before, after = row[0], row[1], row[nx], row[nx + 1]
                light[5] += s + first - before
                light[6] += s + after - second
                squares[5] += q + first * first - before * before
                squares[6] += q + after * after - second * second


@part
def correlations(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    at: NDArray[np.int64],
    to: NDArray[np.int64],
    size: tuple[int, int, int],
    c: NDArray[np.float64],
) -> None:
    """C of a window of volume ``a`` with the one of ``b`` at ``to``, and with those before and after it along z, y and
    x: ``c`` (7,). Planes are copied into rows that follow one another, so that a plane's products are one sum."""
    nz, ny, nx = size
    wide = nx + 2
    products, light, squares = np.zeros(7), np.zeros(7), np.zeros(7)
    planes, own = np.zeros((3, (ny + 2) * wide), np.float32), np.zeros(ny * wide, np.float32)
    total = 0.0
    for k in range(-1, nz + 1):
        copied(b, to[0] + k, to[1], to[2], size, planes[k % 3], light, squares, k)
        some = np.float32(0)
        for j in range(ny if k > 0 else 0):
            row, out = a[at[0] + k - 1, at[1] + j, at[2] : at[2] + nx], own[j * wide :]
            for i in range(nx):
                out[i] = row[i]
                some += row[i]
        if some == np.float32(0):
            continue
        total += float(some)
        for n in range(7):
            along_z, along_y, along_x = (n == 2) - (n == 1), (n == 4) - (n == 3), (n == 6) - (n == 5)
            begin = (1 + along_y) * wide + 1 + along_x
            products[n] += product_of(own, planes[(k + 2 + along_z) % 3], begin, ny * wide - 2)
    count = nz * ny * nx
    mean = total / count
    for n in range(7):
        spread = squares[n] - light[n] * light[n] / count
        c[n] = (products[n] - mean * light[n]) / np.sqrt(spread) if spread > 1e-6 * squares[n] else 0.0


@kernel
def refine(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    corners: NDArray[np.int64],
    size: NDArray[np.int64],
    vectors: NDArray[np.float64],
    again: NDArray[np.bool_],
) -> None:
    """``vectors`` (count, 3), x y z, of windows whose first voxels are ``corners`` (count, 3), z y x; ``again``: which
    were found."""
    at, to, whole, c = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64), np.empty(7)
    for n in range(corners.shape[0]):
        for axis in range(3):
            whole[axis] = np.int64(np.rint(vectors[n, 2 - axis]))
        for _ in range(MOVES + 1):
            inside = True
            for axis in range(3):
                back, room = whole[axis] // 2, a.shape[axis]
                one = corners[n, axis] - back
                two = one + whole[axis]
                # both move together to where they, and the second's neighbours, lie inside
                low, high = min(one, two - 1), max(one, two + 1) + size[axis]
                shift = max(0, -low) - max(0, high - room)
                inside &= low + shift >= 0 and high + shift <= room and abs(shift) <= size[axis] // 8
                at[axis], to[axis] = one + shift, two + shift
            if not inside:
                break
            correlations(a, b, at, to, (size[0], size[1], size[2]), c)
            best = 0
            for k in range(1, 7):
                best = k if c[k] > c[best] else best
            if best == 0:
                again[n] = c[0] > 0.0
                for axis in range(3):
                    off = gaussian_offset(c[2 * axis + 1], c[0], c[2 * axis + 2])
                    vectors[n, 2 - axis] = whole[axis] + off if again[n] else vectors[n, 2 - axis]
                break
            whole[(best - 1) // 2] += 1 if best % 2 == 0 else -1
