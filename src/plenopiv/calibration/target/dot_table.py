"""A dot's share of light in a microlens' cell, tabulated.

The dot is an evenly bright disc; what a pixel sees of it is spread by the pixel's own portion of the main lens, a
square, and collected by the cell of a microlens. Disc, square and cell convolved are one smooth function of where the
dot's image is centred.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.lattice import LatticeKind

BEYOND = 1.5  # cells beyond the disc's rim that the table reaches, and a fit takes, for the ground
STEP = 1 / 24  # of the table, cells
FINE = 4  # points to a step where disc and cell are laid out; even, so that none falls on an edge


@dataclass(frozen=True)
class DotTable:
    """A dot's share of light in a cell, by where the dot's image is centred from the cell's, with both slopes: splines'
    coefficients on a grid of STEP cells, along the lattice's rows and across."""

    middle: int
    share: NDArray[np.float64]
    along: NDArray[np.float64]
    across: NDArray[np.float64]

    @classmethod
    def of(cls, kind: LatticeKind, radius: float, half: float) -> DotTable:
        """``radius`` of the disc and ``half`` the side of a pixel's square, cells."""
        from scipy.ndimage import spline_filter

        middle = ceil((radius + half + BEYOND + 1.5) / STEP)
        axis = np.arange(-middle, middle + 1) * STEP
        x, y = np.meshgrid(axis, axis)
        disc, cell = np.zeros_like(x), np.zeros_like(x)
        for dx in (np.arange(FINE) - (FINE - 1) / 2) * (STEP / FINE):
            for dy in (np.arange(FINE) - (FINE - 1) / 2) * (STEP / FINE):
                disc += (x + dx) ** 2 + (y + dy) ** 2 <= radius**2
                u, v = abs(x + dx), abs(y + dy)
                cell += (u <= 0.5) & ((u + sqrt(3.0) * v <= 1) if kind == "hexagonal" else (v <= 0.5))
        box = np.sinc(np.fft.fftfreq(axis.size, STEP) * 2 * half)
        spectrum = np.fft.fft2(np.fft.ifftshift(disc / disc.sum())) * np.fft.fft2(np.fft.ifftshift(cell / FINE**2))
        share = np.fft.fftshift(np.fft.ifft2(spectrum * box[:, None] * box).real)
        across, along = np.gradient(share, STEP)
        return cls(middle, spline_filter(share), spline_filter(along), spline_filter(across))

    def __call__(
        self, off: NDArray[np.float64], up: NDArray[np.float64], turn: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Share and its slopes along s and t (n,) at offsets along s and t (n,), in cells; ``turn``: of the rows."""
        from scipy.ndimage import map_coordinates

        c, s = np.cos(turn), np.sin(turn)
        at = np.stack([c * up - s * off, c * off + s * up]) / STEP + self.middle
        share, along, across = (
            map_coordinates(t, at, order=3, prefilter=False) for t in (self.share, self.along, self.across)
        )
        return share, c * along - s * across, s * along + c * across
