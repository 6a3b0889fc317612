"""The white image: the evenly lit main lens as every microlens images it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation import kernels
from plenopiv.simulation.images import check_simulated, diffraction_sigma_mm
from plenopiv.threads import in_threads


def white_image(
    camera: PlenopticCamera,
    electrons_per_pixel: float = 5000.0,
    *,
    falloff: float = 0.0,
    diffraction_nm: float | None = None,
) -> NDArray[np.float64]:
    """Mean electrons of every pixel under uniform light, upright, float64 (rows, columns).

    A microlens centred at S shows the aperture as a disc of diameter e P_m centred at S (1 + e); the discs touch when
    the f-numbers match. A pixel at a rim gets the exact share that the discs cover, a whole one
    ``electrons_per_pixel``. A main lens that blurs changes nothing: its light on the microlens plane is even, and
    keeps its directions. ``falloff`` is the share of light lost in the sensor's corners, growing with the square of
    the distance from its centre. ``diffraction_nm``: wavelength of the microlenses' diffraction blur, or None.

    Raises PlenoPIVError for a falloff outside 0-1 and for a camera that is not simulated (``check_simulated``).
    """
    check_simulated(camera)
    if not 0.0 <= falloff < 1.0:
        raise PlenoPIVError(f"white image: falloff = {falloff}, give the share of light lost in the corners, 0 to 1")
    sensor, lattice = camera.sensor, camera.lattice
    image = np.empty((sensor.rows, sensor.columns))
    column0, row0 = sensor.axis
    px = (1.0 + camera.image_scale) / sensor.pixel_pitch_mm  # a microlens' place on the sensor, in pixels
    in_threads(
        kernels.aperture_images, sensor.rows, image,
        camera.aperture_radius_px, lattice.kind == "hexagonal", lattice.pitch_mm * px, lattice.rotation_rad,
        lattice.offset_mm[0] * px, lattice.offset_mm[1] * px, column0, row0,
    )  # fmt: skip
    if diffraction_nm is not None:
        image = blurred(image, diffraction_sigma_mm(camera, diffraction_nm) / sensor.pixel_pitch_mm)
    if falloff:
        c = np.arange(sensor.columns) - column0
        r = np.arange(sensor.rows) - row0
        image *= 1.0 - falloff * ((c / (column0 + 0.5)) ** 2 + (r[:, None] / (row0 + 0.5)) ** 2) / 2.0
    image *= electrons_per_pixel
    return image


def blurred(image: NDArray[np.float64], sigma_px: float) -> NDArray[np.float64]:
    """A Gaussian blur; below half a pixel three taps of the same variance, since a sampled Gaussian misses it."""
    from scipy import ndimage

    if sigma_px > 0.5:
        return ndimage.gaussian_filter(image, sigma_px, mode="nearest")
    side = 0.5 * sigma_px**2
    taps = [side, 1.0 - 2.0 * side, side]
    return ndimage.correlate1d(ndimage.correlate1d(image, taps, 0, mode="nearest"), taps, 1, mode="nearest")
