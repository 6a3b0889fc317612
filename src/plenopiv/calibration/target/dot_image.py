"""The image of a dot in the views of a light field, and the dot's place in lens space by least squares.

Through the place q of the main lens a dot falls on the microlens plane about A q + c with c = B x (``optics``), and
what a pixel collects of it under the microlens S is a function of A q + c - S alone (``dot_table``). A, c, the dot's
light and the ground's follow from all pixels of all views by Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.target.dot_table import BEYOND, DotTable
from plenopiv.cameras.lens_space import lens_place
from plenopiv.lightfield import Layout, LightField

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MOST_STEPS = 12
LARGEST_STEP = 0.4  # pitches by which an iteration may move a dot's image
CONVERGED = 1e-5  # pitches
READ_NOISE = 20.0  # counts^2: pixels of the dark ground weigh alike
SOUND = 0.5  # share of a dot's pixels that must be seen
FEWEST_VIEWS = 5  # of a microlens that lie wholly inside the aperture
FEW = 0.2  # of what the median view knows of its shift: of views at the edge, which few microlenses have, none is told
EDGE_PX, LIT = 0.3, 0.995  # blur of the aperture's edge, and the light that the rim leaves, of pixels that are used


@dataclass(frozen=True)
class DotFit:
    """Dots in lens space. ``place_mm`` (n, 3); ``std_mm`` (n, 3) of it; ``misfit`` (n,), RMS residual over its expected
    noise; ``whole`` (n,): no pixel that the dot lights lies beyond the sensor; ``found`` (n,): the fit converged.

    ``view_shift_mm`` (views, 2): by how much the images of all whole dots lie aside in each view, on the microlens
    plane; NaN in views that are not used.
    """

    place_mm: NDArray[np.float64]
    std_mm: NDArray[np.float64]
    misfit: NDArray[np.float64]
    whole: NDArray[np.bool_]
    found: NDArray[np.bool_]
    view_shift_mm: NDArray[np.float64]


class _Pixels(NamedTuple):
    """The pixels about a dot: view and lens of each, where the dot's image is centred from the lens' cell (cells along
    s and t), and whether none is beyond the sensor."""

    view: NDArray[np.int64]
    lens: NDArray[np.int64]
    off: NDArray[np.float64]
    up: NDArray[np.float64]
    whole: bool


def _wholly_lit(layout: Layout) -> NDArray[np.bool_]:
    """(view, lens): where the pixel lies inside the aperture and the rim of the main lens, and not at their edges."""
    across, up = (
        np.abs(offset[:, None] - phase) for offset, phase in zip(layout.offsets.T, layout.phase.T, strict=True)
    )
    inside = np.hypot(across + 0.5, up + 0.5) < layout.camera.aperture_radius_px - EDGE_PX
    return inside if layout.light is None else inside & (layout.light > LIT)


class DotImages:
    """Fits dots to one image of a target, decoded as a light field.

    ``counts_per_electron``: of the pixels' shot noise, by which pixels are weighted. ``aperture_mm``: diameter of what
    is used of the aperture, pixels that neither it nor the lens' rim clips.
    """

    def __init__(self, lightfield: LightField, counts_per_electron: float = 1.0):
        from scipy.spatial import cKDTree

        layout, camera = lightfield.layout, lightfield.layout.camera
        self.camera, self.gain = camera, counts_per_electron
        self.pitch, self.turn = camera.lattice.pitch_mm, camera.lattice.aligned().rotation_rad
        j, i = np.mgrid[layout.j0 : layout.j0 + layout.nj, layout.i0 : layout.i0 + layout.ni]
        self.lens_mm = np.stack(camera.lattice.centres(i.ravel(), j.ravel()), -1)
        lit = _wholly_lit(layout)
        if lit.sum() < FEWEST_VIEWS * layout.lenses:
            lit[:] = True
        self.views, self.all_views = np.flatnonzero((layout.seen & lit).any(1)), layout.views
        self.values, self.lit, self.seen = lightfield.values[self.views], lit[self.views], layout.seen[self.views]
        column, row = layout.pixel.T[:, None] + layout.offsets[self.views].T[:, :, None]
        sensor = camera.sensor
        self.on_sensor = (column >= 0) & (column < sensor.columns) & (row >= 0) & (row < sensor.rows)
        m, n = layout.offsets[self.views].T
        self.qx = (m[:, None] - layout.phase[:, 0]) * camera.portion_mm
        self.qy = (layout.phase[:, 1] - n[:, None]) * camera.portion_mm
        self.tree: cKDTree = cKDTree(self.lens_mm)
        self.aperture_mm = 2 * sqrt((self.lit & self.seen).sum(0).max() / pi) * camera.portion_mm
        self.reach_mm = float(np.hypot(self.qx, self.qy).max())
        self._tables: dict[tuple[float, float], DotTable] = {}

    def fit(self, places_mm: NDArray[np.float64], diameters_mm: Sequence[float] | NDArray) -> DotFit:
        """The dots near ``places_mm`` (n, 3) in lens space, ``diameters_mm`` (n,) wide there."""
        n = len(places_mm)
        image, std, misfit = np.tile([0.0, 0.0, 0.0], (n, 1)), np.full((n, 3), np.inf), np.full(n, np.inf)
        whole, found = np.zeros(n, bool), np.zeros(n, bool)
        shifts = np.zeros((self.views.size, 2, 3))
        for k, (place, diameter) in enumerate(zip(places_mm, diameters_mm, strict=True)):
            one = self._one(np.asarray(place, float), float(diameter))
            if one is not None:
                image[k], std[k], misfit[k], whole[k], found[k], of_views = one
                shifts += of_views if whole[k] and found[k] else 0
        lens = self.camera.main_lens
        place = lens_place(self.camera, image[:, 0], image[:, 1:])
        distance = lens.object_distance_mm - place[:, 2]
        across = std[:, 1:] * (distance / lens.image_distance_mm)[:, None]
        std = np.column_stack([across, std[:, 0] * distance**2 / lens.image_distance_mm])
        moved = np.full((self.all_views, 2), np.nan)
        known = np.trace(shifts[:, :, :2], axis1=1, axis2=2)
        seen = known > FEW * np.median(known) if whole.any() else np.zeros(known.size, bool)
        moved[self.views[seen]] = np.linalg.solve(shifts[seen][:, :, :2], shifts[seen][:, :, 2:])[..., 0]
        return DotFit(place, std, misfit, whole, found, moved)

    def _table(self, spread: float, radius: float) -> DotTable:
        """The table for a dot of ``radius`` pitches on the microlens plane where A is ``spread``, rounded so that dots
        of a plane share it."""
        key = round(spread, 3), round(radius, 3)
        if key not in self._tables:
            half = abs(key[0]) * self.camera.portion_mm / 2 / ((1 - key[0]) * self.pitch)
            self._tables[key] = DotTable.of(self.camera.lattice.kind, key[1] / (1 - key[0]), half)
        return self._tables[key]

    def _pixels(self, image: NDArray[np.float64], radius: float) -> _Pixels | None:
        """The pixels that a dot of ``radius`` pitches with ``image`` (A and c) lights, and the ground around it; None
        where too few are seen."""
        a, c, reach = image[0], image[1:], radius + BEYOND
        if not np.isfinite(image).all():
            return None
        lenses = np.array(self.tree.query_ball_point(c, abs(a) * self.reach_mm + reach * self.pitch), int)
        if not lenses.size:
            return None
        cell = (1 - a) * self.pitch
        off = (a * self.qx[:, lenses] + c[0] - self.lens_mm[lenses, 0]) / cell
        up = (a * self.qy[:, lenses] + c[1] - self.lens_mm[lenses, 1]) / cell
        view, near = np.nonzero((off**2 + up**2 < reach**2) & self.lit[:, lenses])
        seen = self.seen[view, lenses[near]]
        if seen.mean() < SOUND or seen.sum() < 30:
            return None
        whole = bool(self.on_sensor[view, lenses[near]].all())
        view, near = view[seen], near[seen]
        return _Pixels(view, lenses[near], off[view, near], up[view, near], whole)

    def _one(self, place: NDArray[np.float64], diameter_mm: float) -> tuple | None:
        """A and c of one dot, their standard deviations, misfit, whether it is whole, whether it is brighter than the
        ground, and of each view the normal equations (views, 2, 3) of its shift; None where it is not found."""
        spread, scale = float(self.camera.spread(place[2])), float(self.camera.scale(place[2]))
        radius = 0.5 * diameter_mm * abs(scale) / self.pitch
        table, image = self._table(spread, radius), np.array([spread, *(scale * place[:2])])
        light = ground = None
        unit = np.array([1 / self.reach_mm, 1.0, 1.0]) * self.pitch
        pixels = self._pixels(image, radius)
        for _ in range(MOST_STEPS):
            if pixels is None:
                return None
            at = pixels.view, pixels.lens
            share, along_s, along_t = table(pixels.off, pixels.up, self.turn)
            counts = self.values[at].astype(float)
            if light is None:
                light, ground = np.linalg.lstsq(np.stack([share, np.ones_like(share)], 1), counts, rcond=None)[0]
            slope = light / ((1 - image[0]) * self.pitch)
            along_s, along_t = slope * along_s, slope * along_t
            parts = (along_s * self.qx[at] + along_t * self.qy[at], along_s, along_t, share, np.ones_like(share))
            weight = 1 / np.sqrt(np.maximum(light * share + ground, 0) * self.gain + READ_NOISE)
            jacobian, residual = np.stack(parts, 1) * weight[:, None], (counts - light * share - ground) * weight
            normal = jacobian.T @ jacobian
            if not np.linalg.cond(normal) < 1e14:
                return None
            change = np.linalg.solve(normal, jacobian.T @ residual)
            change[:3] = np.clip(change[:3], -LARGEST_STEP * unit, LARGEST_STEP * unit)
            image, light, ground = image + change[:3], light + change[3], ground + change[4]
            if (np.abs(change[:3]) < CONVERGED * unit).all():
                break
            pixels = self._pixels(image, radius)
        else:
            return None
        misfit = sqrt(float(np.mean(residual**2)))
        std = np.sqrt(np.diag(np.linalg.inv(normal)))[:3] * max(misfit, 1.0)
        found = bool(light > 0)
        return image, std, misfit, pixels.whole, found, self._of_views(pixels.view, jacobian[:, 1:3], residual)

    def _of_views(self, view: NDArray, jacobian: NDArray, residual: NDArray) -> NDArray[np.float64]:
        """The normal equations (views, 2, 3) of a shift along s and t in each view."""
        out = np.empty((self.views.size, 2, 3))
        for a in range(2):
            for b, other in enumerate((jacobian[:, 0], jacobian[:, 1], residual)):
                out[:, a, b] = np.bincount(view, jacobian[:, a] * other, self.views.size)
        return out
