"""Light of a point through a main lens that is not sharp: integrals over the aperture in plain NumPy, independent of
every kernel."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr


def unsharp_point_image(camera, point_mm, n: int = 1500) -> np.ndarray:
    """Upright image (rows, columns) of a point for a square lattice along the axes, sum 1 over an unlimited sensor.

    Where the ray through u would meet the microlens plane at s, it lies under the microlens at S with the probability
    that s displaced by the Gaussian is within half a pitch of S, along x and y independently. Each of both is a matrix
    (node of the aperture, pixel); the disc couples their nodes.
    """
    assert camera.lattice.kind == "square"
    assert camera.lattice.rotation_rad == 0.0
    x, y, z = point_mm
    radius = 0.5 * camera.main_lens.aperture_mm
    nodes = radius * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
    disc = (nodes[:, None] ** 2 + nodes[None, :] ** 2 < radius**2).astype(float)
    c0, r0 = camera.sensor.axis
    columns = _axis(camera, nodes, x, z, camera.lattice.offset_mm[0], -1, c0, camera.sensor.columns)
    rows = _axis(camera, nodes, y, z, camera.lattice.offset_mm[1], +1, r0, camera.sensor.rows)
    return (rows.T @ disc @ columns) / disc.sum()


def _axis(camera, u, x_mm, z_mm, offset_mm, flip, axis_px, pixels):
    """(node, pixel): how likely the ray through ``u`` reaches a pixel along one axis."""
    a, b, e = float(camera.spread(z_mm)), float(camera.scale(z_mm)), camera.image_scale
    pitch, sigma = camera.lattice.pitch_mm, camera.blur_mm
    s = a * u + b * x_mm
    out = np.zeros((u.size, pixels))
    for lens in range(-60, 61):
        place = offset_mm + lens * pitch
        share = ndtr((place + pitch / 2 - s) / sigma) - ndtr((place - pitch / 2 - s) / sigma)
        hit = place * (1 + e) + e * ((s - place) - u)
        middle = axis_px + flip * hit / camera.sensor.pixel_pitch_mm
        half = 0.5 * e * (u[1] - u[0]) / camera.sensor.pixel_pitch_mm  # of a node's light, px
        first, last = (np.rint(middle + side).astype(int) for side in (-half, half))
        beyond = np.where(first == last, 0.0, (middle + half - first - 0.5) / (2 * half))
        for pixel, part in ((first, 1.0 - beyond), (last, beyond)):
            on = (pixel >= 0) & (pixel < pixels)
            np.add.at(out, (np.flatnonzero(on), pixel[on]), (share * part)[on])
    return out
