"""White images for tests: discs on a lattice, area-sampled by brute force; shares no code with what it tests."""

from math import cos, radians, sin, sqrt

import numpy as np

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

PIXEL_MM, E = 0.0055, 0.00308  # f_l / S_i of the camera below


def camera_for(shape, kind, image_pitch_px, aperture_mm=25.0, black_level=60.0):
    """A camera whose micro-images are this far apart (px)."""
    pitch_mm = image_pitch_px * PIXEL_MM / (1.0 + E)
    sensor = Sensor(columns=shape[1], rows=shape[0], pixel_pitch_mm=PIXEL_MM, bit_depth=12, black_level=black_level)
    return PlenopticCamera(MainLens(50.0, aperture_mm, -1.0), Lattice(kind, pitch_mm), 0.308, sensor)


def true_centres(shape, kind, pitch_px, rotation_deg, offset_px):
    """(s, t) in px from the axis of every micro-image on the sensor and just around it."""
    n = int(np.hypot(*shape) / pitch_px / 1.5) + 3
    i, j = np.mgrid[-n : n + 1, -n : n + 1]
    a = pitch_px * (i + (0.5 * (j % 2) if kind == "hexagonal" else 0.0))
    b = pitch_px * j * (sqrt(3.0) / 2.0 if kind == "hexagonal" else 1.0)
    c, d = cos(radians(rotation_deg)), sin(radians(rotation_deg))
    s, t = offset_px[0] + c * a - d * b, offset_px[1] + d * a + c * b
    near = (abs(s) < shape[1] / 2 + pitch_px) & (abs(t) < shape[0] / 2 + pitch_px)
    return s[near], t[near]


def white_image(
    shape, kind, pitch_px, rotation_deg=0.0, offset_px=(0.0, 0.0), *, fill=1.0, electrons=2500.0, black_level=60.0,
    falloff=0.3, dust=0.01, seed=0, centres=None, sub=8,
):  # fmt: skip
    """Upright counts: discs ``fill`` pitches wide (light adds up where they overlap), fall-off, dust, shot noise."""
    rng = np.random.default_rng(seed)
    rows, columns = shape
    s, t = true_centres(shape, kind, pitch_px, rotation_deg, offset_px) if centres is None else centres
    column, row = (columns - 1) / 2 - s, (rows - 1) / 2 + t  # upright: columns grow with -s, rows with +t
    transmission = np.where(rng.random(len(s)) < dust, 0.2, 1.0)
    half = int(np.ceil(0.5 * fill * pitch_px)) + 1
    light = np.zeros((rows + 4 * half, columns + 4 * half))
    cells = (np.arange((2 * half + 1) * sub) + 0.5) / sub - 0.5 - half
    for c, r, f in zip(column, row, transmission, strict=True):
        c0, r0 = round(c), round(r)
        if -half <= c0 < columns + half and -half <= r0 < rows + half:
            lit = np.hypot(cells - (c - c0), cells[:, None] - (r - r0)) < 0.5 * fill * pitch_px
            area = lit.reshape(2 * half + 1, sub, 2 * half + 1, sub).mean((1, 3))
            light[r0 + half : r0 + 3 * half + 1, c0 + half : c0 + 3 * half + 1] += f * area
    light = light[2 * half : 2 * half + rows, 2 * half : 2 * half + columns]
    x, y = np.arange(columns) / columns - 0.5, np.arange(rows)[:, None] / rows - 0.5
    illumination = (1.0 - 2.0 * falloff * (x**2 + y**2)) * (1.0 - 0.2 * x)
    counts = rng.poisson(light * illumination * electrons) + rng.normal(black_level, 2.0, shape)
    return np.clip(np.rint(counts), 0, 4095).astype(np.uint16)


def worst_error_px(fit, camera, centres):
    """Largest distance (px) of a true centre on the sensor from the nearest centre of the fitted lattice."""
    s, t = centres
    on = (abs(s) < camera.sensor.columns / 2) & (abs(t) < camera.sensor.rows / 2)
    mm = PIXEL_MM / (1.0 + E)
    fitted_s, fitted_t = fit.lattice.centres(*fit.lattice.nearest(s[on] * mm, t[on] * mm))
    return float(np.hypot(fitted_s / mm - s[on], fitted_t / mm - t[on]).max())
