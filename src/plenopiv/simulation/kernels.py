"""The ray tracer's inner loops. Double precision, lengths in mm, images upright.

Work is cut into *items*, a stretch of one particle's rays with an image patch of its own; patches are added to the
image in item order. So the image depends neither on the number of threads nor on the batching.
"""

from __future__ import annotations

from math import cos, floor, log, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import plain_kernel, plain_part

GOLDEN = (sqrt(5.0) - 1.0) / 2.0
HEXAGONAL_ROW = sqrt(3.0) / 2.0
LARGEST_DEVIATE = 8.6  # of normal_pair: sqrt(-2 log 2^-53)


@plain_part
def mix(seed: np.uint64, counter: int) -> np.uint64:
    """64 random bits of a counter (splitmix64; Steele, Lea & Flood 2014)."""
    z = np.uint64(seed) + (np.uint64(counter) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@plain_part
def uniform(seed: np.uint64, counter: int) -> float:
    """A number in [0, 1) for a counter."""
    return float(mix(seed, counter) >> np.uint64(11)) * 1.1102230246251565e-16


@plain_part
def normal_pair(seed: np.uint64, counter: int) -> tuple[float, float]:
    """Two standard normal deviates (Box-Muller)."""
    r = sqrt(-2.0 * log(1.0 - uniform(seed, counter)))
    angle = 2.0 * pi * uniform(seed, counter + 1)
    return r * cos(angle), r * sin(angle)


@plain_part
def nearest_lens(a: float, b: float, hexagonal: bool) -> tuple[float, float]:
    """Centre, in pitches from lens (0, 0), of the lens whose cell holds the lattice coordinates (a, b).

    On a hexagonal lattice it is the nearest lens of the row below or that of the row above.
    """
    if not hexagonal:
        return float(floor(a + 0.5)), float(floor(b + 0.5))
    below = floor(b / HEXAGONAL_ROW)
    odd = 0.5 * (below & 1)
    i, k = floor(a - odd + 0.5) + odd, floor(a + odd) + 0.5 - odd  # the row above has the other shift
    up = b - below * HEXAGONAL_ROW
    down = HEXAGONAL_ROW - up
    if (a - i) ** 2 + up**2 <= (a - k) ** 2 + down**2:
        return i, below * HEXAGONAL_ROW
    return k, (below + 1.0) * HEXAGONAL_ROW


@plain_kernel
def trace_items(
    begin: int, end: int,  # items to trace
    particle: NDArray[np.int64],  # (items,): which particle
    first_ray: NDArray[np.int64],  # (items,)
    last_ray: NDArray[np.int64],  # (items,): one past
    window: NDArray[np.int64],  # (items, 4): first column, first row, columns, rows of the patch
    start: NDArray[np.int64],  # (items,): where the patch begins in patches
    patches: NDArray[np.float64],  # zeros on entry
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64],  # (particles,): position
    spread: NDArray[np.float64], scale: NDArray[np.float64],  # (particles,): A, B
    weight: NDArray[np.float64],  # (particles,): electrons per ray
    rays: int,
    stratified: bool,
    seed: np.uint64,
    aperture_radius_mm: float,
    particle_sigma_mm: float,
    lens_sigma_mm: float,  # of the main lens' blur on the microlens plane
    blur_sigma_mm: float,  # of the microlenses' on the sensor
    hexagonal: bool, pitch_mm: float, rotation_rad: float, offset_s_mm: float, offset_t_mm: float,
    image_scale: float,
    column0: float, row0: float, pixel_mm: float,
) -> None:  # fmt: skip
    """Trace rays of every item into its patch.

    ``s = A u + B x``; the microlens at S that holds (s, t) sends the ray to ``S (1 + e) + e ((s - S) - u)`` on the
    sensor (Eqs. 1-5 multiplied out). Stratified rays form a golden-angle spiral over the aperture, equal areas to equal
    numbers, turned and shifted at random for each particle so that the mean is exact. A main lens that blurs displaces
    (s, t) by a Gaussian; as the ray keeps its direction, the microlens that then holds it sends it to ``S (1 + e) + e
    ((s - S) - u)`` with the (s, t) from before.
    """
    turn_c, turn_s = cos(2.0 * pi * GOLDEN), sin(2.0 * pi * GOLDEN)
    rot_c, rot_s = cos(rotation_rad), sin(rotation_rad)
    for item in range(begin, end):
        p = particle[item]
        own = mix(seed, p)
        shift, angle0 = uniform(own, np.int64(0)), uniform(own, np.int64(1))
        ray_seed = mix(own, np.int64(2))
        col_lo, row_lo, cols, rows = window[item]
        base = start[item]
        angle = 2.0 * pi * ((first_ray[item] * GOLDEN + angle0) % 1.0)
        c, s_ = cos(angle), sin(angle)
        for ray in range(first_ray[item], last_ray[item]):
            if stratified:
                r = aperture_radius_mm * sqrt((ray + shift) / rays)
                u, v = r * c, r * s_
                c, s_ = c * turn_c - s_ * turn_s, s_ * turn_c + c * turn_s
            else:
                r = aperture_radius_mm * sqrt(uniform(ray_seed, 8 * ray))
                angle = 2.0 * pi * uniform(ray_seed, 8 * ray + 1)
                u, v = r * cos(angle), r * sin(angle)
            x, y = x_mm[p], y_mm[p]
            if particle_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray + 2)
                x += particle_sigma_mm * dx
                y += particle_sigma_mm * dy
            s = spread[p] * u + scale[p] * x
            t = spread[p] * v + scale[p] * y
            ds, dt = s - offset_s_mm, t - offset_t_mm
            if lens_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray + 6)
                ds += lens_sigma_mm * dx
                dt += lens_sigma_mm * dy
            a, b = (rot_c * ds + rot_s * dt) / pitch_mm, (rot_c * dt - rot_s * ds) / pitch_mm
            a, b = nearest_lens(a, b, hexagonal)
            lens_s = offset_s_mm + (rot_c * a - rot_s * b) * pitch_mm
            lens_t = offset_t_mm + (rot_s * a + rot_c * b) * pitch_mm
            hit_s = lens_s * (1.0 + image_scale) + image_scale * ((s - lens_s) - u)
            hit_t = lens_t * (1.0 + image_scale) + image_scale * ((t - lens_t) - v)
            if blur_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray + 4)
                hit_s += blur_sigma_mm * dx
                hit_t += blur_sigma_mm * dy
            column = floor(column0 - hit_s / pixel_mm + 0.5) - col_lo
            row = floor(row0 + hit_t / pixel_mm + 0.5) - row_lo
            if 0 <= column < cols and 0 <= row < rows:
                patches[base + row * cols + column] += weight[p]


@plain_kernel
def add_patches(
    begin: int,
    end: int,
    image: NDArray[np.float64],
    window: NDArray[np.int64],
    start: NDArray[np.int64],
    patches: NDArray[np.float64],
) -> None:
    """Add patches to rows ``begin`` to ``end`` of the image (rows, columns) in item order."""
    for row in range(begin, end):
        for item in range(start.size):
            col_lo, row_lo, cols, rows = window[item]
            if row_lo <= row < row_lo + rows:
                at = start[item] + (row - row_lo) * cols
                for k in range(cols):
                    image[row, col_lo + k] += patches[at + k]


@plain_part
def _corner_area(x: float, y: float, radius: float) -> float:
    """Area of the part of a disc about the origin with 0 < coordinates < (x, y); odd in x and in y."""
    sign = (1.0 if x > 0 else -1.0) * (1.0 if y > 0 else -1.0)
    x, y = min(abs(x), radius), min(abs(y), radius)
    if x * x + y * y <= radius * radius:
        return sign * x * y
    # under y as far as the arc is above y, then under the arc as far as x
    turn = sqrt(radius * radius - y * y)
    area = turn * y + 0.5 * (x * sqrt(radius * radius - x * x) - turn * y)
    area += 0.5 * radius * radius * (np.arcsin(x / radius) - np.arcsin(turn / radius))
    return sign * area


@plain_part
def disc_in_pixel(dx: float, dy: float, radius: float) -> float:
    """Share of a unit pixel that a disc centred (dx, dy) pixels away from the pixel's centre covers; exact."""
    x0, x1, y0, y1 = -dx - 0.5, -dx + 0.5, -dy - 0.5, -dy + 0.5
    return (
        _corner_area(x1, y1, radius)
        - _corner_area(x0, y1, radius)
        - _corner_area(x1, y0, radius)
        + _corner_area(x0, y0, radius)
    )


@plain_kernel
def aperture_images(
    begin: int, end: int, image: NDArray[np.float64], radius_px: float, hexagonal: bool, pitch_px: float,
    rotation_rad: float, offset_s_px: float, offset_t_px: float, column0: float, row0: float,
) -> None:  # fmt: skip
    """Fill rows ``begin`` to ``end`` of the image with the share of each pixel that discs centred on the lattice's
    nodes cover, all summed.

    Lengths in pixels on the sensor: the lattice is that of the micro-images.
    """
    rot_c, rot_s = cos(rotation_rad), sin(rotation_rad)
    reach = radius_px + 0.7072
    spacing = HEXAGONAL_ROW if hexagonal else 1.0
    span = int(reach / (pitch_px * spacing) + 0.71) + 1
    for row in range(begin, end):
        for column in range(image.shape[1]):
            s, t = column0 - column, row - row0
            ds, dt = s - offset_s_px, t - offset_t_px
            a, b = (rot_c * ds + rot_s * dt) / pitch_px, (rot_c * dt - rot_s * ds) / pitch_px
            _, centre = nearest_lens(a, b, hexagonal)
            middle = floor(centre / spacing + 0.5)
            total = 0.0
            for j in range(middle - span, middle + span + 1):
                odd = 0.5 * (j & 1) if hexagonal else 0.0
                nearest = floor(a - odd + 0.5) + odd
                for i in range(-span, span + 1):
                    da, db = nearest + i - a, j * spacing - b
                    if (da * da + db * db) * pitch_px * pitch_px < reach * reach:
                        # back to sensor axes; the column axis runs against s, which an even area does not see
                        disc_s = (rot_c * da - rot_s * db) * pitch_px
                        disc_t = (rot_s * da + rot_c * db) * pitch_px
                        total += disc_in_pixel(disc_s, disc_t, radius_px)
            image[row, column] = max(total, 0.0)  # differences of areas leave -1e-17
