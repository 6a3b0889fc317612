"""Exit pupil and stop from the outlines of micro-images.

A micro-image is what two discs share: the image of the stop and that of the lens' rim (``calibration.cat_eyes``). Under
a microlens at S each is centred at S (1 + f_l/D), D being its distance from the microlenses, so that the two move apart
over the sensor. The rim is at the lens, whose distance the target tells; the other is the exit pupil, the stop's image
by the lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.aperture import aperture_disc
from plenopiv.calibration.cat_eyes import find_rim, refined
from plenopiv.calibration.micro_images import inside
from plenopiv.cameras.plenoptic import PlenopticCamera

PARTS = 4  # of the micro-images, each fitted by itself, for the standard deviation
STEPS = 12
MOST = 3000  # micro-images that are fitted
DRAWS = 2000


@dataclass(frozen=True)
class Outline:
    """Two discs that bound micro-images, (2,) and with standard deviations: ``growth``, f_l/D of each, and radius in
    px."""

    growth: NDArray[np.float64]
    growth_std: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    radius_std: NDArray[np.float64]


def outline(white: NDArray, camera: PlenopticCamera) -> Outline | None:
    """The two discs of an upright white image (rows, columns); None where only one is to be seen. ``camera``: that of
    lens space, whose image distance stands for the micro-images' centres."""
    image, lattice, e = np.asarray(white)[:, ::-1], camera.lattice, camera.image_scale
    disc = aperture_disc(white, camera)
    reach = int(np.hypot(*image.shape) / camera.image_pitch_px) + 2
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    s, t = lattice.centres(i.ravel(), j.ravel())
    position = (s + 1j * t) * ((1 + e) / camera.sensor.pixel_pitch_mm)
    position = position[inside(image.shape, position, disc.half_window)]
    found = find_rim(image, position, disc)
    if found is None:
        return None
    some = np.random.default_rng(0).permutation(position.size)[:MOST]
    each = []
    for part in np.array_split(some, PARTS):
        (own, rim), _ = refined(image, position[part], *found, STEPS)
        if rim is not None:
            each.append([e, e + rim.slip * (1 + e), own.radius_px, rim.radius_px])
    values = np.array(each)
    mean, std = values.mean(0), values.std(0, ddof=1) / np.sqrt(len(values))
    return Outline(mean[:2], std[:2], mean[2:], std[2:])


def pupil_and_stop(
    seen: Outline, camera: PlenopticCamera, optics: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[dict[str, float], dict[str, float]]:
    """Exit pupil, stop and rim, and their standard deviations, in mm. ``optics`` (3,), ``covariance`` (3, 3): focal
    length and image distance of the main lens, focal length of the microlenses.

    ``exit_pupil_mm``: from the microlenses; ``stop_mm``: in front of the lens, negative: behind it.
    """
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(optics, covariance, DRAWS)
    growth = seen.growth + seen.growth_std * rng.standard_normal((DRAWS, 2))
    radius = seen.radius_px + seen.radius_std * rng.standard_normal((DRAWS, 2))
    stop = int(np.argmax(np.abs(optics[2] / seen.growth - optics[1])))  # the rim is where the lens is
    found = [
        _stop(camera, o[0], o[1], o[2], g[stop], r[stop], g[1 - stop], r[1 - stop])
        for o, g, r in zip((optics, *drawn), (seen.growth, *growth), (seen.radius_px, *radius), strict=True)
    ]
    names = "exit_pupil_mm", "exit_pupil_radius_mm", "stop_mm", "stop_radius_mm", "rim_radius_mm"
    values, std = found[0], np.std(found[1:], axis=0)
    return dict(zip(names, map(float, values), strict=True)), dict(zip(names, map(float, std), strict=True))


def _stop(
    camera: PlenopticCamera, f: float, si: float, fl: float, growth: float, radius: float, of_rim: float, rim: float
) -> tuple[float, float, float, float, float]:
    """Distance and radius of the exit pupil, the stop that the lens images there, and the rim's radius."""
    pixel = camera.sensor.pixel_pitch_mm
    pupil = fl / growth
    wide = radius * pixel / growth
    behind = pupil - si  # the exit pupil from the lens, on the object's side
    if behind < 0:  # a stop behind the lens is seen by the microlenses as it is
        return pupil, wide, behind, wide, rim * pixel / of_rim
    stop = behind * f / (f + behind)
    return pupil, wide, stop, wide * (stop / behind if behind else 1.0), rim * pixel / of_rim
