"""Light of a point with diffraction, ray by ray in plain NumPy: independent of every kernel."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from scipy.special import erf, ndtri
from scipy.stats.qmc import Sobol


def blurred_light(camera, position_mm, blur_px: float, rays: int = 200_000):
    """Shares of a point's light, an upright image (rows, columns): rays evenly over the aperture, each through the
    nearest microlens, spread over pixels as a Gaussian of standard deviation ``blur_px`` is. Where the main lens blurs,
    each is first displaced on the microlens plane, its direction kept."""
    x, y, z = position_mm
    a, b, e = float(camera.spread(z)), float(camera.scale(z)), camera.image_scale
    turn = 2.0 * pi * (sqrt(5.0) - 1.0) / 2.0 * np.arange(rays)
    r = 0.5 * camera.main_lens.aperture_mm * np.sqrt((np.arange(rays) + 0.5) / rays)
    u, v = r * np.cos(turn), r * np.sin(turn)
    s, t = a * u + b * x, a * v + b * y
    aside = np.zeros((2, rays))
    if camera.blur_mm > 0:
        u, v, *aside = _spread_evenly(0.5 * camera.main_lens.aperture_mm, camera.blur_mm, rays)
        s, t = a * u + b * x, a * v + b * y
    lens_s, lens_t = camera.lattice.centres(*camera.lattice.nearest(s + aside[0], t + aside[1]))
    hit_s = lens_s * (1.0 + e) + e * ((s - lens_s) - u)
    hit_t = lens_t * (1.0 + e) + e * ((t - lens_t) - v)
    column, row = camera.sensor.pixel_from_plane(hit_s, hit_t)
    shape = camera.sensor.rows, camera.sensor.columns
    image = np.zeros(shape)
    middle = np.rint(column).astype(int), np.rint(row).astype(int)
    steps = (-2, -1, 0, 1, 2)
    across = {dx: _in_pixel(column - middle[0] - dx, blur_px) for dx in steps}
    down = {dy: _in_pixel(row - middle[1] - dy, blur_px) for dy in steps}
    for dx in steps:
        for dy in steps:
            c, q = middle[0] + dx, middle[1] + dy
            on = (c >= 0) & (c < shape[1]) & (q >= 0) & (q < shape[0])
            part = across[dx] * down[dy] / rays
            image += np.bincount((q * shape[1] + c)[on], part[on], image.size).reshape(shape)
    return image


def _spread_evenly(radius: float, sigma: float, rays: int):
    """Places (u, v) on the aperture and displacements (ds, dt) of a Gaussian, ``rays`` each, even in all four."""
    even = np.clip(Sobol(4, seed=1).random_base2((rays - 1).bit_length())[:rays], 1e-9, 1.0 - 1e-9).T
    r, turn = radius * np.sqrt(even[0]), 2.0 * pi * even[1]
    return r * np.cos(turn), r * np.sin(turn), *(sigma * ndtri(even[2:]))


def _in_pixel(off, blur_px: float):
    """Share of a Gaussian ``off`` px from a pixel's middle that falls on the pixel, along one axis."""
    return 0.5 * (erf((off + 0.5) / (sqrt(2.0) * blur_px)) - erf((off - 0.5) / (sqrt(2.0) * blur_px)))
