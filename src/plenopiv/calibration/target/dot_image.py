"""The image of a dot in the views of a light field, and the dot's place in lens space by least squares.

A dot is an evenly bright disc. Through the place q of the main lens it falls on the microlens plane about A q + c with
c = B x (``optics``), and what a pixel collects of it under the microlens S is the share of the disc's light, spread by
the pixel's own portion of the lens, that lies in the cell of S (``projection.plenoptic.geometry``). Disc, portion and
cell convolved are one smooth function of A q + c - S, tabulated once for all dots of a diameter in a plane; A, c, the
dot's light and the ground's follow from all pixels of all views by Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.lattice import LatticeKind
from plenopiv.lightfield import LightField

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

STEP = 1 / 24  # of the table, cells
FINE = 5  # points to a step where disc and cell are laid out
BEYOND = 1.5  # cells beyond the disc's rim that are fitted, for the ground
MOST_STEPS = 12
LARGEST_STEP = 0.4  # pitches by which an iteration may move a dot's image
CONVERGED = 1e-5  # pitches
READ_NOISE = 20.0  # counts^2: pixels of the dark ground weigh alike
SOUND = 0.5  # share of a dot's pixels that must be seen


@dataclass(frozen=True)
class DotFit:
    """Dots in lens space. ``place_mm`` (n, 3); ``std_mm`` (n, 3) of it; ``light`` (n,) in counts of a pixel that a dot
    lights wholly; ``misfit`` (n,), RMS residual over its expected noise; ``whole`` (n,): every pixel that the dot
    lights was seen; ``found`` (n,): the fit converged."""

    place_mm: NDArray[np.float64]
    std_mm: NDArray[np.float64]
    light: NDArray[np.float64]
    misfit: NDArray[np.float64]
    whole: NDArray[np.bool_]
    found: NDArray[np.bool_]


class DotImages:
    """Fits dots to one image of a target, decoded as a light field.

    ``counts_per_electron``: of the pixels' shot noise, by which pixels are weighted. ``aperture_mm``: diameter of the
    views that are used, those wholly inside the rim.
    """

    def __init__(self, lightfield: LightField, counts_per_electron: float = 1.0):
        from scipy.spatial import cKDTree

        layout, camera = lightfield.layout, lightfield.layout.camera
        self.camera, self.gain = camera, counts_per_electron
        j, i = np.mgrid[layout.j0 : layout.j0 + layout.nj, layout.i0 : layout.i0 + layout.ni]
        self.lens_mm = np.stack(camera.lattice.centres(i.ravel(), j.ravel()), -1)
        whole = np.hypot(*layout.offsets.T) + 0.5 * sqrt(2.0) + 0.5 < camera.aperture_radius_px
        views = np.flatnonzero(whole) if whole.sum() >= 5 else np.arange(layout.views)
        self.values, self.seen = lightfield.values[views], layout.seen[views]
        m, n = layout.offsets[views].T
        self.qx = (m[:, None] - layout.phase[:, 0]) * camera.portion_mm
        self.qy = (layout.phase[:, 1] - n[:, None]) * camera.portion_mm
        self.tree: cKDTree = cKDTree(self.lens_mm)
        self.aperture_mm = 2 * sqrt(views.size / pi) * camera.portion_mm
        self.reach_mm = float(np.hypot(self.qx, self.qy).max())
        self._tables: dict[tuple[float, float], _Table] = {}

    def fit(self, places_mm: NDArray[np.float64], diameters_mm: Sequence[float] | NDArray) -> DotFit:
        """The dots near ``places_mm`` (n, 3) in lens space, ``diameters_mm`` (n,) wide there."""
        lens = self.camera.main_lens
        found = [self._one(place, float(d)) for place, d in zip(places_mm, diameters_mm, strict=True)]
        n = len(found)
        image, std, light, misfit, whole, good = (
            (np.array(v) for v in zip(*found, strict=True)) if n else [np.zeros(0)] * 6
        )
        image, std = image.reshape(n, 3), std.reshape(n, 3)
        distance = lens.image_distance_mm / (image[:, 0] - 1 + lens.image_distance_mm / lens.focal_length_mm)
        scale = -lens.image_distance_mm / distance
        place = np.column_stack([image[:, 1:] / scale[:, None], lens.object_distance_mm - distance])
        std = np.column_stack([std[:, 1:] / abs(scale)[:, None], std[:, 0] * distance**2 / lens.image_distance_mm])
        return DotFit(place, std, light, misfit, whole.astype(bool), good.astype(bool))

    def _table(self, spread: float, radius: float) -> _Table:
        """The table for a dot ``radius`` pitches wide on the microlens plane where A is ``spread``, rounded so that
        dots of a plane share it."""
        key = round(spread, 3), round(radius, 2)
        if key not in self._tables:
            half = abs(key[0]) * self.camera.portion_mm / 2 / ((1 - key[0]) * self.camera.lattice.pitch_mm)
            self._tables[key] = _Table.of(self.camera.lattice.kind, key[1] / (1 - key[0]), half)
        return self._tables[key]

    def _one(self, place: NDArray[np.float64], diameter_mm: float) -> tuple[NDArray, NDArray, float, float, bool, bool]:
        """A and c of one dot, their standard deviations, its light, misfit, whether it is whole, and whether found."""
        camera = self.camera
        pitch, turn = camera.lattice.pitch_mm, camera.lattice.aligned().rotation_rad
        scale = float(camera.scale(place[2]))
        radius = 0.5 * diameter_mm * abs(scale) / pitch
        table = self._table(float(camera.spread(place[2])), radius)
        image = np.array([float(camera.spread(place[2])), *(scale * place[:2])])
        lost = image, np.full(3, np.inf), 0.0, np.inf, False, False
        light = ground = 0.0
        reach, converged = (radius + BEYOND) * pitch, False
        limits = np.array([LARGEST_STEP * pitch / self.reach_mm, LARGEST_STEP * pitch, LARGEST_STEP * pitch])
        for step in range(MOST_STEPS):
            a, c = image[0], image[1:]
            lenses = np.array(self.tree.query_ball_point(c, abs(a) * self.reach_mm + reach), int)
            if not lenses.size or not np.isfinite(image).all():
                return lost
            off = (a * self.qx[:, lenses] + c[0] - self.lens_mm[lenses, 0]) / ((1 - a) * pitch)
            up = (a * self.qy[:, lenses] + c[1] - self.lens_mm[lenses, 1]) / ((1 - a) * pitch)
            view, near = np.nonzero(off**2 + up**2 < (reach / pitch) ** 2)
            there = self.seen[view, lenses[near]]
            if there.mean() < SOUND or there.sum() < 30:
                return lost
            pixels = view[there], lenses[near[there]]
            off, up = off[view[there], near[there]], up[view[there], near[there]]
            share, along_s, along_t = table(off, up, turn)
            counts = self.values[pixels].astype(float)
            if step == 0:
                light, ground = np.linalg.lstsq(np.stack([share, np.ones_like(share)], 1), counts, rcond=None)[0]
            slope = light / ((1 - a) * pitch)
            jacobian = np.stack(
                [
                    slope * (along_s * self.qx[pixels] + along_t * self.qy[pixels]),
                    slope * along_s,
                    slope * along_t,
                    share,
                    np.ones_like(share),
                ],
                1,
            )
            weight = 1 / np.sqrt(np.maximum(light * share + ground, 0) * self.gain + READ_NOISE)
            residual = counts - light * share - ground
            left = jacobian * weight[:, None]
            normal = left.T @ left
            try:
                change = np.linalg.solve(normal, left.T @ (residual * weight))
            except np.linalg.LinAlgError:
                return lost
            change[:3] = np.clip(change[:3], -limits, limits)
            image, light, ground = image + change[:3], light + change[3], ground + change[4]
            converged = bool((np.abs(change[:3]) < CONVERGED * pitch * np.array([1 / self.reach_mm, 1, 1])).all())
            if converged:
                break
        misfit = sqrt(float(np.mean((residual * weight) ** 2)))
        std = np.sqrt(np.diag(np.linalg.inv(normal)))[:3] * max(misfit, 1.0)
        return image, std, light, misfit, bool(there.all()), converged and light > 0


@dataclass(frozen=True)
class _Table:
    """A dot's share of light in a cell, by where the dot's image is centred from the cell's, with both slopes: splines'
    coefficients on a grid of STEP cells, along the lattice's rows and across."""

    middle: int
    share: NDArray[np.float64]
    along: NDArray[np.float64]
    across: NDArray[np.float64]

    @classmethod
    def of(cls, kind: LatticeKind, radius: float, half: float) -> _Table:
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
