"""Which dot is which: numbers along the target's x and y, counted from its origin's dot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.dot_board import number_dots
from plenopiv.calibration.target.board import Board
from plenopiv.errors import PlenoPIVError

STARTS = 12  # dots that are tried as the first, from the middle outward
ENOUGH = 0.6  # share of a plane's dots that one grid must join
LIKE = 0.35  # natural logarithm by which a marked dot's light may differ from its size's
TURNS = np.array([[[1, 0], [0, 1]], [[0, 1], [-1, 0]], [[-1, 0], [0, -1]], [[0, -1], [1, 0]]])  # by quarters


@dataclass(frozen=True)
class Grid:
    """Dots of one plane on one grid of unknown origin. ``dot`` (n,): which dots; ``number`` (n, 2): along the image's
    right and upward."""

    dot: NDArray[np.int64]
    number: NDArray[np.int64]


def on_grid(place_mm: NDArray[np.float64], name: str) -> Grid:
    """The dots at ``place_mm`` (n, 2), x and y, that lie on one square grid with those in the middle.

    Raises:
        PlenoPIVError: ``name`` first, too few do.
    """
    pixel = place_mm * (1.0, -1.0)
    middle = np.median(pixel, 0)
    best: dict[int, tuple[int, int]] = {}
    for start in np.argsort(np.hypot(*(pixel - middle).T))[:STARTS]:
        found = number_dots(pixel, int(start))
        if len(found) > len(best):
            best = found
        if len(best) >= ENOUGH * len(pixel):
            break
    if len(best) < max(9, ENOUGH / 2 * len(pixel)):
        raise PlenoPIVError(
            f"{name}: only {len(best)} of {len(pixel)} dots lie on one square grid; check calibration.pitch_mm, and "
            "that the image shows the target alone"
        )
    dots = np.array(sorted(best))
    return Grid(dots, np.array([best[n] for n in dots.tolist()]))


def origin_of(grid: Grid, light: NDArray[np.float64], board: Board) -> tuple[NDArray[np.int64], int] | None:
    """Number (2,) of the origin's dot on the grid, and by how many quarters the target's x is turned from the image's
    right; None where no dot, or more than one, is marked as the origin's. ``light`` (n,) of all dots, in that of an
    unmarked one."""
    number, found = [tuple(n) for n in grid.number.tolist()], light[grid.dot]
    where = {n: k for k, n in enumerate(number)}
    marked = 2 * np.log(board.origin_dot_mm / board.dot_mm)
    beside = 2 * np.log((board.x_dot_mm or board.dot_mm) / board.dot_mm)
    off = np.abs(np.log(np.maximum(found, 1e-3)) - marked)
    fits = []
    for k in np.flatnonzero(off < LIKE):
        for turn in range(4) if board.x_dot_mm else (0,):
            neighbour = where.get((number[k][0] + int(TURNS[turn][0][0]), number[k][1] + int(TURNS[turn][0][1])))
            if neighbour is None:
                continue
            wrong = abs(np.log(max(found[neighbour], 1e-3)) - beside)
            if wrong < LIKE:
                fits.append((off[k] ** 2 + wrong**2, k, turn))
    if not fits:
        return None
    fits.sort()
    if len(fits) > 1 and fits[1][0] < 2 * fits[0][0] + 0.01 and fits[1][1:] != fits[0][1:]:
        return None
    _, k, turn = fits[0]
    return grid.number[k], turn


def numbered(
    grids: Sequence[Grid],
    places_mm: Sequence[NDArray[np.float64]],
    lights: Sequence[NDArray[np.float64]],
    z_mm: Sequence[float],
    board: Board,
    names: Sequence[str],
) -> list[NDArray[np.int64]]:
    """Numbers (n, 2) on the target of the dots of each grid. ``places_mm``: (dots, 3) of each plane. Planes whose
    marked dots are hidden are numbered by the others'.

    Raises:
        PlenoPIVError: no plane shows the marked dots, or two planes turn the target differently.
    """
    found = [origin_of(grid, light, board) for grid, light in zip(grids, lights, strict=True)]
    known = [k for k, each in enumerate(found) if each is not None]
    if not known:
        raise PlenoPIVError(
            f"{names[0]} and the other planes: none shows the dot of calibration.origin_dot_mm"
            + (" with that of x_dot_mm beside it" if board.x_dot_mm else "")
            + "; keep it in the image, or correct the diameters"
        )
    turns = [each[1] for each in found if each is not None]
    turn = max(set(turns), key=turns.count)
    for k in list(known):
        each = found[k]
        if each is not None and each[1] != turn:
            found[k] = None
            known.remove(k)
    origin_place = {}
    for k in known:
        each = found[k]
        assert each is not None
        dot = grids[k].dot[(grids[k].number == each[0]).all(1)][0]
        origin_place[k] = places_mm[k][dot, :2]
    numbers = []
    for k, grid in enumerate(grids):
        each = found[k]
        if each is None:  # where the marked dot must be, by the two nearest planes that show it
            near = sorted(known, key=lambda other: abs(z_mm[other] - z_mm[k]))[:2]
            expected = origin_place[near[0]]
            if len(near) == 2 and z_mm[near[0]] != z_mm[near[1]]:
                slope = (origin_place[near[1]] - origin_place[near[0]]) / (z_mm[near[1]] - z_mm[near[0]])
                expected = expected + slope * (z_mm[k] - z_mm[near[0]])
            origin = _number_at(grid, places_mm[k][grid.dot, :2], expected)
        else:
            origin = each[0]
        numbers.append((grid.number - origin) @ TURNS[turn].T)
    return numbers


def _number_at(grid: Grid, place_mm: NDArray[np.float64], expected_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """The number that a dot at ``expected_mm`` (2,) has on the grid."""
    terms = np.column_stack([place_mm, np.ones(len(place_mm))])
    affine = np.linalg.lstsq(terms, grid.number.astype(float), rcond=None)[0]
    return np.rint(np.append(expected_mm, 1.0) @ affine).astype(np.int64)
