"""White images of random cameras, drawn micro-image by micro-image; shares no code with what it tests.

A micro-image is the disc of the stop's image about the chief ray, cut by the image of the lens' rim, which lies the
further beside it the further the microlens is from the axis (cat's eye). Discs may be shaded within, overlap, or be
small spots; the array may be stretched, sheared and distorted; the sensor may saturate, have stripes, hot pixels and
noise; dust and dead microlenses darken some. ``draw`` makes the camera as a user would state it, the image, and the
true chief rays, all from a seed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import hypot, sqrt

import numpy as np
from scipy import ndimage
from scipy.special import expit

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

PIXEL_MM, E, BLACK, FULL = 0.0055, 0.00308, 60.0, 4095  # E: f_l / S_i of the camera stated
ELECTRONS_PER_COUNT = 2.5
SUB = 8  # cells across a pixel in which a disc is drawn


@dataclass(frozen=True)
class RandomCamera:
    """What is drawn. Lengths in pixels; fields named below only where the name does not say it."""

    kind: str
    side: int
    pitch: float
    turn_deg: float
    offset: tuple[float, float]
    stretch: float  # rows further apart than lenses along them
    shear: float
    cubic: complex  # displacement at the corner: radial, and (imaginary) tangential
    quadratic: complex
    fill: float  # width of the stop's image over the pitch
    rim: float  # radius of the rim's image over the stop's; 0 for none
    slip: float  # of the rim's image at the corner, over the stop's radius
    blur: float
    falloff: float  # share of light lost at the corner
    centre: tuple[float, float]  # of the falloff and the cat's eye, over half the side
    ramp: tuple[float, float]  # of the light within a micro-image, from its middle to its rim
    bow: float
    electrons: float
    read_noise: float
    hot: float
    dead: float
    dust: int
    overexposed: float  # peak over the full scale; 0: as the exposure is
    stripes: float  # share of the light
    line_noise: float  # electrons
    stated_pitch: float  # over the true one
    stated_aperture: float
    seed: int

    def numbers(self):
        """The fields as plain numbers."""
        return {k: (str(v) if isinstance(v, complex) else v) for k, v in asdict(self).items()}


def random_camera(seed: int) -> RandomCamera:
    """The camera of a seed. Each disturbance is there in a part of the cameras."""
    rng = np.random.default_rng([27, seed])

    def often(share, low, high, otherwise=0.0):
        value = rng.uniform(low, high)
        return float(value) if rng.random() < share else otherwise

    pitch = float(np.exp(rng.uniform(np.log(6.0), np.log(40.0))))
    shape = rng.random()
    fill = rng.uniform(0.9, 1.0) if shape < 0.55 else rng.uniform(0.6, 0.9) if shape < 0.75 else rng.uniform(1.0, 1.12)
    if shape > 0.88:
        fill = max(rng.uniform(0.2, 0.4), 1.6 / pitch)  # spots; narrower than 1.6 px no lens images them
    cat = rng.random() < 0.45 and fill > 0.5
    turned = rng.uniform(0, 2 * np.pi, 2)
    overexposed = often(0.12, 1.0, 1.3)
    return RandomCamera(
        kind=str(rng.choice(["square", "hexagonal"])),
        side=int(np.clip(26 * pitch, 420, 900)),
        pitch=pitch,
        turn_deg=float(rng.uniform(-6, 6)),
        offset=tuple(rng.uniform(-0.5, 0.5, 2) * pitch),
        stretch=often(0.6, -0.005, 0.005),
        shear=often(0.4, -0.002, 0.002),
        cubic=complex(often(0.5, -2.0, 2.0), often(0.2, -0.3, 0.3)),
        quadratic=often(0.3, 0.0, 0.7) * complex(np.exp(1j * turned[0])),
        fill=float(fill),
        rim=float(rng.uniform(1.03, 1.35)) if cat else 0.0,
        slip=float(rng.uniform(0.1, 0.9)) if cat else 0.0,
        blur=float(rng.uniform(0.25, 0.7)),
        falloff=often(0.7, 0.1, 0.7),
        centre=tuple(rng.uniform(-0.2, 0.2, 2)),
        ramp=(often(0.3, -0.25, 0.25), often(0.3, -0.25, 0.25)),
        bow=often(0.4, -0.4, 0.3),
        electrons=float(np.exp(rng.uniform(np.log(250.0), np.log(8000.0)))),
        read_noise=often(0.5, 3.0, 25.0, 3.0),
        hot=often(0.5, 0.0, 0.004),
        dead=often(0.4, 0.0, 0.03),
        dust=int(often(0.5, 1.0, 9.0)),
        overexposed=overexposed,
        stripes=often(0.25, 0.0, 0.06),
        line_noise=often(0.2, 0.0, 10.0),
        stated_pitch=float(rng.uniform(0.985, 1.015)),
        stated_aperture=float(rng.uniform(0.9, 1.1)),
        seed=seed,
    )


def chief_rays(of: RandomCamera) -> tuple[np.ndarray, np.ndarray]:
    """(s, t) in pixels from the axis of the chief rays of all microlenses on the sensor and just around it."""
    n = int(of.side / of.pitch) + 3
    i, j = np.mgrid[-n : n + 1, -n : n + 1]
    hexagonal = of.kind == "hexagonal"
    a = of.pitch * (i + (0.5 * (j % 2) if hexagonal else 0.0))
    b = of.pitch * j * (sqrt(3.0) / 2.0 if hexagonal else 1.0) * (1.0 + of.stretch)
    z = complex(*of.offset) + np.exp(1j * np.radians(of.turn_deg)) * (a + of.shear * b + 1j * b)
    corner = of.side / sqrt(2.0)
    u = z / corner
    z = z + of.cubic * u * np.abs(u) ** 2 + of.quadratic * u**2
    near = (np.abs(z.real) < of.side / 2 + 1.2 * of.pitch) & (np.abs(z.imag) < of.side / 2 + 1.2 * of.pitch)
    return z.real[near], z.imag[near]


def _light(of: RandomCamera, rng: np.random.Generator) -> np.ndarray:
    """Light of every pixel of the upright image, 1 in the middle of an unshaded micro-image on the axis."""
    s, t = chief_rays(of)
    corner, radius = of.side / sqrt(2.0), 0.5 * of.fill * of.pitch
    away = (s + 1j * t) / corner - complex(*of.centre) / sqrt(2.0)
    gain = (1.0 - of.falloff * np.minimum(np.abs(away) ** 2, 1.2)) * rng.normal(1.0, 0.01, s.size)
    gain = np.where(rng.random(s.size) < of.dead, rng.uniform(0.0, 0.3, s.size), gain)
    half = int(np.ceil(radius)) + 1
    pad = 2 * half + int(np.ceil(1.2 * of.pitch)) + 2
    out = np.zeros((of.side + 2 * pad,) * 2)
    width = 2 * half + 1
    cells = (np.arange(width * SUB) + 0.5) / SUB - 0.5 - half
    middle = (of.side - 1) / 2.0
    for x, y, g, off in zip(middle - s, middle + t, gain, away, strict=True):
        c, r = round(x), round(y)
        dx, dy = cells - (x - c), (cells - (y - r))[:, None]
        squared = dx**2 + dy**2
        lit = squared < radius**2
        if of.rim:
            slip = of.slip * radius * off  # columns grow with -s
            lit &= (dx + slip.real) ** 2 + (dy - slip.imag) ** 2 < (of.rim * radius) ** 2
        shade = 1.0 + (of.ramp[0] * dx + of.ramp[1] * dy) / radius + of.bow * squared / radius**2
        area = (lit * shade).reshape(width, SUB, width, SUB).mean((1, 3))
        top, left = r - half + pad, c - half + pad
        if min(top, left) >= 0 and max(top, left) + width <= len(out):
            out[top : top + width, left : left + width] += g * area
    return ndimage.gaussian_filter(out, of.blur)[pad:-pad, pad:-pad]


def _dusted(of: RandomCamera, light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    rows, columns = np.mgrid[: of.side, : of.side]
    for _ in range(of.dust):
        c, r = rng.uniform(0, of.side, 2)
        size, dark = rng.uniform(0.1, 1.5) * of.pitch, rng.uniform(0.2, 0.8)
        light = light * (1.0 - dark * expit((size - np.hypot(columns - c, rows - r)) / 0.7))
    return light


def draw(of: RandomCamera) -> tuple[PlenopticCamera, np.ndarray]:
    """The camera as its user states it, and its white image (rows, columns) in counts, upright."""
    rng = np.random.default_rng([28, of.seed])
    light = _dusted(of, _light(of, rng), rng)
    if of.stripes:
        period, angle = rng.uniform(3, 60), rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
        r, c = np.mgrid[: of.side, : of.side]
        light = light * (1.0 + of.stripes * np.sin(2 * np.pi * (c * np.cos(angle) + r * np.sin(angle)) / period))
    electrons = light * of.electrons
    if of.overexposed:
        electrons = light / np.percentile(light, 99.5) * of.overexposed * (FULL - BLACK) * ELECTRONS_PER_COUNT
    noise = rng.normal(0.0, of.read_noise, light.shape) + rng.normal(0.0, of.line_noise, of.side)[:, None]
    counts = (rng.poisson(electrons) + noise) / ELECTRONS_PER_COUNT + BLACK
    hot = rng.random(light.shape) < of.hot
    counts[hot] += rng.exponential(1500.0, np.count_nonzero(hot))
    counts = np.clip(np.rint(counts), 0, FULL).astype(np.uint16)
    return stated(of), counts


def stated(of: RandomCamera, kind: str | None = None, pitch: float = 1.0) -> PlenopticCamera:
    """The camera on its data sheet; ``kind`` and a factor of the ``pitch`` make it another one."""
    mm = of.pitch * of.stated_pitch * pitch * PIXEL_MM / (1.0 + E)
    sensor = Sensor(of.side, of.side, PIXEL_MM, 12, BLACK)
    aperture = of.fill * of.pitch * of.stated_aperture * PIXEL_MM / E
    return PlenopticCamera(MainLens(50.0, aperture, -1.0), Lattice(kind or of.kind, mm), 100.0 * E, sensor)


def errors_px(of: RandomCamera, lattice: Lattice) -> np.ndarray:
    """How far the nearest centre of a lattice is from each chief ray on the sensor, pixels."""
    s, t = chief_rays(of)
    on = (np.abs(s) < of.side / 2) & (np.abs(t) < of.side / 2)
    mm = PIXEL_MM / (1.0 + E)
    found_s, found_t = lattice.centres(*lattice.nearest(s[on] * mm, t[on] * mm))
    return np.hypot(found_s / mm - s[on], found_t / mm - t[on])


def cat_eye_px(of: RandomCamera) -> float:
    """How deep the rim cuts into the micro-images at the farthest corner, pixels."""
    radius = 0.5 * of.fill * of.pitch
    return max(0.0, radius * (of.slip * (1.0 + hypot(*of.centre) / sqrt(2.0)) - of.rim + 1.0)) if of.rim else 0.0
