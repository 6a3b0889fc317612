"""Decoded views instead of raw pixels: bilinear interpolation to whole pixels from each micro-image's centre.

What toolboxes for light-field photography do. A real micro-image's centre lies a fraction (a, b) of a pixel off the
pixels, another one under each lens. Interpolated there, a value is

    J = (1-a)(1-b) I_00 + a (1-b) I_10 + (1-a) b I_01 + a b I_11.

The four weights add up to 1: counts keep their mean. The variance of white noise falls to

    ((1-a)^2 + a^2) ((1-b)^2 + b^2) of the raw pixel's,     4/9 on average over evenly spread a, b,

but each raw pixel now speaks in up to four values: neighbours along a row or column have the covariance
a (1-a) ((1-b)^2 + b^2), on average 1/6 x 2/3 or a quarter of the variance, and the sum over all of them has the
variance it always had. Nothing is gained; what MART takes for independent equations no longer are. And a value sees the
aperture through two pixels' width: the variance of the portion of the main lens grows from 1/12 to 1/12 + a (1-a),
on average 1/4 pixel^2, threefold.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import Layout, LightField, decode, disc_share


def variance_factor(phase: NDArray) -> NDArray:
    """Variance of an interpolated value over that of a raw pixel's noise, for phases (..., 2) in px."""
    f = np.abs(phase) % 1.0
    return np.prod((1 - f) ** 2 + f**2, axis=-1)


def covariance_factor(phase: NDArray) -> NDArray:
    """Covariance of two interpolated values one pixel apart along a row over a raw pixel's variance."""
    a, b = np.moveaxis(np.abs(phase) % 1.0, -1, 0)
    return a * (1 - a) * ((1 - b) ** 2 + b**2)


def taps(where: Layout) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The four raw pixels about each micro-image's centre, (lens, 4, 2) column and row, and their weights (lens, 4)."""
    centre = where.pixel + where.phase.astype(np.float64)
    first = np.floor(centre).astype(np.int64)
    a, b = (centre - first).T
    steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    weight = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], -1)
    return first[:, None] + steps, weight


def resampled(image: NDArray, where: Layout) -> LightField:
    """An upright raw image as values at whole pixels from the micro-images' centres, with a layout that says so.

    A value is an equation where the four pixels that it is made of are: seen by the lens, and by no other.
    """
    sensor = where.camera.sensor
    owner = np.full((sensor.rows, sensor.columns), -1)  # the lens whose equation a raw pixel is
    for v, (m, n) in enumerate(where.offsets):
        lens = np.flatnonzero(where.seen[v])
        owner[where.pixel[lens, 1] + n, where.pixel[lens, 0] + m] = lens
    counts = np.asarray(image, np.float64) - sensor.black_level
    pixel, weight = taps(where)
    values, seen = np.zeros(where.seen.shape, np.float32), np.zeros_like(where.seen)
    fill = np.empty_like(where.fill)
    for v, (m, n) in enumerate(where.offsets):
        column, row = pixel[..., 0] + m, pixel[..., 1] + n
        inside = (column >= 0) & (column < sensor.columns) & (row >= 0) & (row < sensor.rows)
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        own = inside & (owner[row, column] == np.arange(where.lenses)[:, None])
        seen[v] = (own | (weight == 0)).all(-1)
        values[v] = np.where(seen[v], (weight * counts[row, column]).sum(-1), 0.0)
        fill[v] = disc_share(float(m), float(n), where.camera.aperture_radius_px)
    keep = seen.any(1)
    layout = replace(
        where,
        phase=np.zeros_like(where.phase),
        offsets=where.offsets[keep],
        fill=fill[keep],
        seen=seen[keep],
    )
    return LightField(layout, values[keep])


def raw_where_resampled(image: NDArray, where: Layout) -> LightField:
    """The raw pixels of those views and lenses alone that resampling has a value for: what the lost equations cost."""
    raw, kept = decode(image, where), resampled(image, where).layout
    views = [where.offsets.tolist().index(offset) for offset in kept.offsets.tolist()]
    seen = where.seen[views] & kept.seen
    layout = replace(where, offsets=kept.offsets, fill=where.fill[views], seen=seen)
    return LightField(layout, np.where(seen, raw.values[views], np.float32(0.0)))
