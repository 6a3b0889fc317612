"""Kernels that gather a real camera's light: of points, ray by ray forward, and of planes, pixel by pixel backward.

Double precision, lengths in mm, images upright. ``real_kernels`` has the optics.
"""

from __future__ import annotations

from math import ceil, cos, floor, isfinite, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import plain_kernel, plain_part
from plenopiv.simulation.kernels import GOLDEN, HEXAGONAL_ROW, mix, nearest_lens, normal_pair, uniform
from plenopiv.simulation.real_kernels import (
    Constants,
    back_into_fluid,
    back_to_pupil,
    cell_offset,
    gap_behind,
    lattice_place,
    lattice_point,
    onto_microlenses,
    onto_sensor,
    pixel_of,
    slopes_to_pupil,
)

# Steps of the sequence that fills four dimensions evenly: powers of 1/x, x^5 = x + 1 (Roberts 2018).
STEPS = tuple(1.1673039782614187**-k for k in (1, 2, 3, 4))


@plain_kernel
def trace_particles(
    begin: int, end: int,  # items to trace
    particle: NDArray[np.int64], first_ray: NDArray[np.int64], last_ray: NDArray[np.int64],
    window: NDArray[np.int64], start: NDArray[np.int64], patches: NDArray[np.float64],  # as kernels.trace_items
    cam: Constants,
    position: NDArray[np.float64],  # (particles, 3) in the camera's frame
    weight: NDArray[np.float64],  # (particles,): electrons per ray
    rays: int,
    seed: np.uint64,
    particle_sigma_mm: float,
    lens_sigma_mm: float,  # of the main lens' blur on the microlens plane
    blur_sigma_mm: float,  # of the microlenses' on the sensor
) -> None:  # fmt: skip
    """Trace rays of every item into its patch: a golden-angle spiral over the entrance pupil, equal areas to equal
    numbers, turned and shifted at random for each particle so that the mean is exact."""
    turn_c, turn_s = cos(2.0 * pi * GOLDEN), sin(2.0 * pi * GOLDEN)
    for item in range(begin, end):
        p = particle[item]
        own = mix(seed, p)
        shift, angle0 = uniform(own, np.int64(0)), uniform(own, np.int64(1))
        ray_seed = mix(own, np.int64(2))
        col_lo, row_lo, cols, rows = window[item]
        angle = 2.0 * pi * ((first_ray[item] * GOLDEN + angle0) % 1.0)
        c, s_ = cos(angle), sin(angle)
        for ray in range(first_ray[item], last_ray[item]):
            r = cam.radius * sqrt((ray + shift) / rays)
            qx, qy = r * c, r * s_
            c, s_ = c * turn_c - s_ * turn_s, s_ * turn_c + c * turn_s
            x, y, z = position[p, 0], position[p, 1], position[p, 2]
            if particle_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray)
                x += particle_sigma_mm * dx
                y += particle_sigma_mm * dy
            mx, my = slopes_to_pupil(cam, x, y, z, qx, qy)
            s, t, ms, mt = onto_microlenses(cam, qx, qy, mx, my)
            if not isfinite(s):
                continue
            if lens_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray + 4)
                s += lens_sigma_mm * dx
                t += lens_sigma_mm * dy
            hit_s, hit_t = onto_sensor(cam, s, t, ms, mt)
            if blur_sigma_mm > 0.0:
                dx, dy = normal_pair(ray_seed, 8 * ray + 2)
                hit_s += blur_sigma_mm * dx
                hit_t += blur_sigma_mm * dy
            column, row = pixel_of(cam, hit_s, hit_t)
            column -= col_lo
            row -= row_lo
            if 0 <= column < cols and 0 <= row < rows:
                patches[start[item] + row * cols + column] += weight[p]


@plain_part
def within_one(x: float) -> float:
    """The part of a number behind its point."""
    return x - floor(x)


@plain_part
def _along(x: float, y: float, z: float, plane: NDArray[np.float64], first: int) -> float:
    """Component of a vector along the axis that begins at ``first``."""
    return x * plane[first] + y * plane[first + 1] + z * plane[first + 2]


@plain_part
def dot_light(
    x: float, y: float, z: float, mx: float, my: float, mz: float,
    plane: NDArray[np.float64], dots: NDArray[np.float64],
) -> float:  # fmt: skip
    """How brightly a target shines along the ray through (x, y, z) with direction (mx, my, mz): 1 from a dot, the
    background's share elsewhere.

    ``plane`` holds the target's origin and the three axes of its frame in the camera's frame, pitch, step, background
    and half sides along x and y. ``dots`` (rows, columns, 4), the origin in its middle: radius and the unit vector and
    distance of the line that cuts a dot, which is dark beyond. Columns of odd numbers lie on a second level ``step``
    farther from the camera; walls between the levels are as dark as the background.
    """
    ox, oy, oz = x - plane[0], y - plane[1], z - plane[2]
    x, y, z = _along(ox, oy, oz, plane, 3), _along(ox, oy, oz, plane, 6), _along(ox, oy, oz, plane, 9)
    mx, my, mz = _along(mx, my, mz, plane, 3), _along(mx, my, mz, plane, 6), _along(mx, my, mz, plane, 9)
    pitch, step, background = plane[12], plane[13], plane[14]
    for nearer in range(2):
        level = (nearer == 1) == (step > 0.0)  # is this the second level? the one nearer to the camera comes first
        way = (-step if level else 0.0) - z
        px, py = x + way / mz * mx, y + way / mz * my
        i, j = floor(px / pitch + 0.5), floor(py / pitch + 0.5)
        if step != 0.0 and (i % 2 == 1) != level:
            continue
        if abs(px) > plane[15] or abs(py) > plane[16]:
            return background
        row, column = j + dots.shape[0] // 2, i + dots.shape[1] // 2
        if not (0 <= row < dots.shape[0] and 0 <= column < dots.shape[1]):
            return background
        dx, dy = px - i * pitch, py - j * pitch
        radius, cut_x, cut_y, cut = dots[row, column]
        lit = dx * dx + dy * dy <= radius * radius and dx * cut_x + dy * cut_y <= cut
        return 1.0 if lit else background
    return background


@plain_kernel
def sample_pixels(
    begin: int, end: int, banks: NDArray[np.float64], cam: Constants, seed: np.uint64
) -> None:  # fmt: skip
    """Fill ``banks`` (banks, samples, 4), from ``begin`` to ``end``, with places evenly over a pixel and a microlens'
    cell, (s, t) in mm from the middle of each; every bank is shifted at random."""
    for bank in range(begin, end):
        own = mix(seed, bank)
        d0, d1, d2, d3 = uniform(own, 0), uniform(own, 1), uniform(own, 2), uniform(own, 3)
        for k in range(banks.shape[1]):
            banks[bank, k, 0] = cam.pixel * (within_one(d0 + k * STEPS[0]) - 0.5)
            banks[bank, k, 1] = cam.pixel * (within_one(d1 + k * STEPS[1]) - 0.5)
            cell_s, cell_t = cell_offset(cam, within_one(d2 + k * STEPS[2]), within_one(d3 + k * STEPS[3]))
            banks[bank, k, 2], banks[bank, k, 3] = cell_s, cell_t


@plain_kernel
def trace_pixels(
    begin: int, end: int, image: NDArray[np.float64], cam: Constants, banks: NDArray[np.float64], seed: np.uint64,
    plane: NDArray[np.float64], dots: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fill rows ``begin`` to ``end`` of the image with the mean brightness of what each pixel sees through the
    microlenses about it, by the rays of one of ``banks`` (``sample_pixels``) for each of these. Without ``dots`` all
    that the stop lets through is 1: a white image."""
    spacing = HEXAGONAL_ROW if cam.hexagonal else 1.0
    grown = 1.0 + cam.gap * cam.to_exit
    cell = 0.71 * cam.pitch * max(cam.stretch, 1.0)  # no cell reaches farther
    span = ceil((cam.micro_radius + cell) / (cam.pitch * spacing) + 0.5)
    for row in range(begin, end):
        for column in range(image.shape[1]):
            middle_s, middle_t = (cam.column0 - column) * cam.pixel, (row - cam.row0) * cam.pixel
            a0, b0 = lattice_place(cam, middle_s / grown, middle_t / grown)
            _, centre = nearest_lens(a0, b0, cam.hexagonal)
            middle = floor(centre / spacing + 0.5)
            bank = banks[mix(seed, row * image.shape[1] + column) % np.uint64(banks.shape[0])]
            total = 0.0
            for j in range(middle - span, middle + span + 1):
                odd = 0.5 * (j & 1) if cam.hexagonal else 0.0
                nearest = floor(a0 - odd + 0.5) + odd
                for i in range(-span, span + 1):
                    lens_s, lens_t = lattice_point(cam, nearest + i, j * spacing)
                    gap = gap_behind(cam, lens_s, lens_t)
                    # from the stop's image: a disc, blurred by where in the cell a ray comes through
                    off_s, off_t = (
                        middle_s - lens_s * (1.0 + gap * cam.to_exit),
                        middle_t - lens_t * (1.0 + gap * cam.to_exit),
                    )
                    blur = cell * (gap * cam.to_exit + abs(gap / cam.gap - 1.0)) + 0.71 * cam.pixel
                    if sqrt(off_s * off_s + off_t * off_t) > cam.micro_radius * gap / cam.gap + blur:
                        continue
                    for place in bank:
                        cell_s, cell_t = place[2], place[3]
                        s, t = lens_s + cell_s, lens_t + cell_t
                        ms = (middle_s + place[0] - s) / gap + cell_s / cam.gap
                        mt = (middle_t + place[1] - t) / gap + cell_t / cam.gap
                        qx, qy, mx, my = back_to_pupil(cam, s, t, ms, mt)
                        if not isfinite(qx):
                            continue
                        if dots.size == 0:
                            total += 1.0
                        else:
                            x, y, z, mx, my, mz = back_into_fluid(cam, qx, qy, mx, my)
                            total += dot_light(x, y, z, mx, my, mz, plane, dots)
            image[row, column] = total / bank.shape[0]
