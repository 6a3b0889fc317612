"""Stacks of grey pictures for a slider: planes of the volume, sub-aperture views, refocusing through depth.

Pictures are small JPEGs in one grey scale, made at once so that neither volume nor light field need be kept.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from plenopiv.lightfield import LightField
from plenopiv.refocusing import image_axes, refocused, sub_aperture
from plenopiv.report.document import place_mm
from plenopiv.volume import Volume

PICTURES = 24  # of a volume at most
SIDE = 420  # pixels along the longer side of a volume's pictures at most
BYTES = 1_500_000  # of a stack at most; pictures of noise alone are saved with less quality
LENSES = 120  # along the longer side of a light field's pictures, around the middle
DEPTHS = 13
VIEWS = 9  # along each of two diameters of the main lens


@dataclass(frozen=True)
class Stack:
    """Pictures under one slider: JPEGs, row 0 on top; ``x`` and ``y`` the limits of their axes, whose ``labels`` carry
    units; ``limits`` of the grey scale in ``unit``; ``start`` the picture that is shown first."""

    name: str
    pictures: tuple[bytes, ...]
    captions: tuple[str, ...]
    x: tuple[float, float]
    y: tuple[float, float]
    limits: tuple[float, float]
    labels: tuple[str, str] = ("x (mm)", "y (mm)")
    unit: str = "counts"
    start: int = 0

    def data(self) -> dict[str, Any]:
        """What the page's script draws."""
        return {
            "pictures": [f"data:image/jpeg;base64,{base64.b64encode(p).decode('ascii')}" for p in self.pictures],
            "captions": self.captions,
            "x": self.x,
            "y": self.y,
            "limits": self.limits,
            "labels": self.labels,
            "unit": self.unit,
        }


def volume_stack(volume: Volume) -> Stack:
    """Planes of a volume across z, the brightest of neighbouring ones where there are more than ``PICTURES``."""
    nz = volume.grid.shape[0]
    (x, y, (z0, z1)), thick = volume.grid.limits_mm(), -(-nz // PICTURES)
    images, captions = [], []
    for lo in range(0, nz, thick):
        hi = min(lo + thick, nz)
        plane = volume.slab(lo, lo + 1)[0]
        for k in range(lo + 1, hi):
            plane = np.maximum(plane, volume.slab(k, k + 1)[0])
        images.append(joined(plane, SIDE)[::-1])
        first, last = ((z1 - z0) * k / nz for k in (lo, hi))
        captions.append(f"z = {_signed(z0 + first, last - first)} to {_signed(z0 + last, last - first)} mm")
    return _stack("volume", images, captions, x, y, unit="intensity (counts)", start=len(images) // 2)


def light_field_stacks(lightfield: LightField, z_mm: tuple[float, float], of_camera: str = "") -> tuple[Stack, Stack]:
    """Sub-aperture views along two diameters of the main lens, and refocusing from ``z_mm[0]`` to ``z_mm[1]``, which
    like x and y are the camera's; ``of_camera``: what captions say of that.

    Of the middle of the picture, ``LENSES`` microlenses along its longer side, one pixel a microlens.
    """
    camera, offsets = lightfield.layout.camera, lightfield.layout.offsets
    x, y = (_middle(axis, LENSES) for axis in image_axes(camera))
    limits = _faces(x), _faces(y)
    names, seen = [], []
    for view in _diameters(offsets):
        m, n = (float(o) * camera.portion_mm for o in offsets[view])
        names.append(f"through the main lens at x = {_signed(m)} mm, y = {_signed(-n)} mm")
        seen.append(np.nan_to_num(sub_aperture(lightfield, view, x, y)))
    depths = np.linspace(*z_mm, DEPTHS)
    sharp = [np.nan_to_num(refocused(lightfield, float(z), x, y)) for z in depths]
    said = [f"z = {_signed(z, depths[1] - depths[0])} mm{of_camera}" for z in depths]
    return (
        _stack("views", seen, names, *limits, start=len(seen) // 4),
        _stack("refocus", sharp, said, *limits, start=DEPTHS // 2),
    )


def joined(image: NDArray, side: int) -> NDArray:
    """Neighbouring pixels joined, the brightest kept, until no side is over ``side``: a particle must not vanish. As
    many or one more or less in each, so that all are alike in width and the picture's limits are the same."""
    for axis, count in enumerate(image.shape):
        n = -(-count // -(-count // side))
        if n < count:
            image = np.fmax.reduceat(image, np.arange(n) * count // n, axis=axis)
    return image


def _diameters(offsets: NDArray) -> list[int]:
    """Views from left to right and from below to above through the middle of the main lens, ``VIEWS`` at most each."""
    chosen = []
    for along, across in ((0, 1), (1, 0)):
        line = np.flatnonzero(offsets[:, across] == 0)
        order = np.argsort(offsets[line, along] * (1 if along == 0 else -1))  # rows run downward
        pick = np.unique(np.linspace(0, len(line) - 1, VIEWS).round().astype(int))
        chosen += [int(v) for v in line[order][pick]]
    return chosen


def _stack(
    name: str,
    images: Sequence[NDArray],
    captions: Iterable[str],
    x: tuple[float, float],
    y: tuple[float, float],
    unit: str = "counts",
    start: int = 0,
) -> Stack:
    """One grey scale for all: from 0 to what one lit pixel in 500 exceeds."""
    lit = [float(np.percentile(image[image > 0], 99.8)) for image in images if (image > 0).any()]
    top = max(lit, default=1.0)
    for quality in (85, 60, 30, 10):
        pictures = tuple(_jpeg(image, top, quality) for image in images)
        if sum(map(len, pictures)) <= BYTES:
            break
    return Stack(name, pictures, tuple(captions), _pair(x), _pair(y), (0.0, top), unit=unit, start=start)


def _jpeg(image: NDArray, top: float, quality: int) -> bytes:
    buffer = io.BytesIO()
    imsave(buffer, image, cmap="gray", vmin=0.0, vmax=top, format="jpeg", pil_kwargs={"quality": quality})
    return buffer.getvalue()


def _middle(axis: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    first = max(0, (axis.size - n) // 2)
    return axis[first : first + n]


def _faces(centres: NDArray[np.float64]) -> tuple[float, float]:
    half = 0.5 * abs(centres[1] - centres[0]) if centres.size > 1 else 0.5
    return float(centres.min() - half), float(centres.max() + half)


def _pair(limits: Sequence[float]) -> tuple[float, float]:
    return float(limits[0]), float(limits[1])


def _signed(value: float, apart: float = 1.0) -> str:
    """With its sign, if there is one, of values so far ``apart``."""
    digits = place_mm(abs(value), np.array([0.0, apart]))
    return digits if float(digits) == 0 else ("−" if value < 0 else "+") + digits
