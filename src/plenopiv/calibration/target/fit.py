"""From images of a target to the map between laboratory and lens space, and how well it holds.

Each dot's place in lens space is measured in all views of its plane (``dot_image``); its place in the laboratory is
known. A polynomial carries one to the other. How well it does is told by leaving each plane out in turn: residuals of a
fit are smaller than errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.target.board import Board, TargetImage
from plenopiv.calibration.target.dot_image import DotFit, DotImages
from plenopiv.calibration.target.find import Spots, find_spots
from plenopiv.calibration.target.numbering import numbered, on_grid
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import Layout, decode

MARGIN = 1.3  # times the traverse's readings, how far from focus the target is searched
FARTHEST = 0.25  # of the object distance: farther from focus no dot is told from its neighbours
OUTLIER = 6.0  # standard deviations beyond which a dot is left out
SAMPLE = 24  # dots of a plane whose width is fitted
WIDER, MOST_WIDER = 0.02, 3.0  # step of that fit, and how many it may go
POOREST_MM = 0.05  # standard deviation in depth of a dot that is still used

ARRAYS = "plane", "number", "laboratory_mm", "reading_mm", "lens_mm", "std_mm", "misfit", "whole"  # of each dot

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Dots:
    """Dots of all planes. ``plane`` (n,): which image; ``number`` (n, 2): along the target's x and y; ``laboratory_mm``
    (n, 3): where each is on a target square to its traverse, which reads ``reading_mm`` (n,); ``lens_mm`` (n, 3): where
    each is in lens space; ``std_mm`` (n, 3): of the latter; ``misfit`` (n,): of its image; ``whole``
    (n,): seen whole. ``aperture_mm``: of the views through which they were measured. ``view_shift_mm`` (planes, views,
    2): by how much all dots of a plane lie aside in a view, on the microlens plane; NaN in views that are not used."""

    plane: NDArray[np.int64]
    number: NDArray[np.int64]
    laboratory_mm: NDArray[np.float64]
    reading_mm: NDArray[np.float64]
    lens_mm: NDArray[np.float64]
    std_mm: NDArray[np.float64]
    misfit: NDArray[np.float64]
    whole: NDArray[np.bool_]
    aperture_mm: float
    view_shift_mm: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.plane)

    def where(self, chosen: NDArray[np.bool_]) -> Dots:
        """Those that are ``chosen`` (n,)."""
        some: dict[str, Any] = {name: getattr(self, name)[chosen] for name in ARRAYS}
        return replace(self, **some)


def measure_dots(
    images: Sequence[TargetImage],
    board: Board,
    layout: Layout,
    counts_per_electron: float = 1.0,
    progress: Progress | None = None,
) -> Dots:
    """The dots of all ``images``, with their numbers and their places in the laboratory and in lens space.

    Raises:
        PlenoPIVError: naming the image, where there is no target, or none shows the origin's dot; naming planes that
            are all at one z or out of order.
    """
    _check_planes(images)
    readings = [image.z_mm for image in images]
    largest = max(np.ptp(readings), np.abs(readings).max())
    reach = min(MARGIN * float(largest) + 1.0, FARTHEST * layout.camera.main_lens.object_distance_mm)
    spots: list[Spots] = []
    fits: list[DotImages] = []
    first: list[DotFit] = []
    for n, image in enumerate(images):
        views = DotImages(decode(image.counts, layout), counts_per_electron)
        found = find_spots(decode(image.counts, layout), board, reach, image.name)
        fits.append(views)
        spots.append(found)
        first.append(views.fit(found.place_mm, np.full(len(found.light), board.dot_mm)))
        if progress:
            progress(n + 1, 2 * len(images))
    lens_z = [float(np.median(fit.place_mm[fit.found, 2])) if fit.found.any() else np.nan for fit in first]
    _check_order(images, lens_z)
    places = [
        np.where(fit.found[:, None], fit.place_mm, found.place_mm) for fit, found in zip(first, spots, strict=True)
    ]
    grids = [on_grid(place[:, :2], image.name) for place, image in zip(places, images, strict=True)]
    lights, z, names = [found.light for found in spots], [i.z_mm for i in images], [i.name for i in images]
    numbers = numbered(grids, places, lights, z, board, names)
    parts = []
    for n, (image, views, grid, number) in enumerate(zip(images, fits, grids, numbers, strict=True)):
        scale = _scale(places[n][grid.dot, :2], number, board.pitch_mm)
        at, width = places[n][grid.dot], board.diameter_mm(number) * scale
        again = views.fit(at, width * _wider(views, at, width))
        part = Dots(
            np.full(len(number), n),
            number,
            board.places_mm(number, image.z_mm),
            np.full(len(number), image.z_mm),
            again.place_mm,
            again.std_mm,
            again.misfit,
            again.whole,
            views.aperture_mm,
            again.view_shift_mm[None],
        )
        parts.append(part.where(again.found & (again.std_mm[:, 2] < POOREST_MM)))
        if progress:
            progress(len(images) + n + 1, 2 * len(images))
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in (*ARRAYS, "view_shift_mm")
    }
    return replace(parts[0], **whole)


def _check_planes(images: Sequence[TargetImage]) -> None:
    if np.unique([image.z_mm for image in images]).size < 2:
        raise PlenoPIVError(
            f"calibration.planes: all {len(images)} are at z = {images[0].z_mm:g} mm; give images of the target at two "
            "depths or more (five or more for a curved map)"
        )
    seen: dict[float, str] = {}
    for image in images:
        if image.z_mm in seen:
            raise PlenoPIVError(
                f"calibration.planes: {seen[image.z_mm]} and {image.name} are both at {image.z_mm:g} mm"
            )
        seen[image.z_mm] = image.name


def _check_order(images: Sequence[TargetImage], lens_z: Sequence[float]) -> None:
    """Depths as measured must rise with the traverse's readings."""
    order = np.argsort([image.z_mm for image in images])
    found = np.array(lens_z)[order]
    if np.isnan(found).any():
        image = images[int(order[np.flatnonzero(np.isnan(found))[0]])]
        raise PlenoPIVError(f"{image.name}: its dots have no depth; is it in the reach of the camera?")
    wrong = np.flatnonzero(np.diff(found) <= 0)
    if len(wrong) == len(found) - 1:
        raise PlenoPIVError(
            "calibration.planes: z_mm grows away from the camera in all of them; z is positive toward the camera: turn "
            "the signs"
        )
    if len(wrong):
        a, b = images[int(order[wrong[0]])], images[int(order[wrong[0] + 1])]
        raise PlenoPIVError(
            f"calibration.planes: out of order: {a.name} is said to be at {a.z_mm:g} mm and {b.name} at {b.z_mm:g} mm, "
            "but the images show the first nearer to the camera; z is positive toward the camera"
        )


def _wider(views: DotImages, place_mm: NDArray[np.float64], width_mm: NDArray[np.float64]) -> float:
    """By what factor dots look wider than they are said to be: paint runs, lenses blur. In focus, where depth is in
    the dots' edges alone, 1 % moves it by 6 um (behind 41 mm of water)."""
    some = np.argsort(np.hypot(*(place_mm[:, :2] - np.median(place_mm[:, :2], 0)).T))[:SAMPLE]
    misfit = []
    for factor in 1 + WIDER * np.arange(-1, 2):
        found = views.fit(place_mm[some], width_mm[some] * factor)
        misfit.append(np.where(found.found, found.misfit**2, np.nan))
    before, here, after = np.nanmedian(np.array(misfit)[:, np.isfinite(misfit).all(0)], 1)
    bend = before - 2 * here + after
    if not bend > 0:
        return 1.0
    return float(1 + WIDER * np.clip(0.5 * (before - after) / bend, -MOST_WIDER, MOST_WIDER))


def _scale(place_mm: NDArray[np.float64], number: NDArray[np.int64], pitch_mm: float) -> float:
    """How much larger lens space is than the laboratory, across, in a plane."""
    terms = np.column_stack([number * pitch_mm, np.ones(len(number))])
    slopes = np.linalg.lstsq(terms, place_mm, rcond=None)[0][:2]
    return float(np.sqrt(abs(np.linalg.det(slopes))))
