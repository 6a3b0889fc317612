"""The same camera with one thing changed: PMR, pixels, magnification, lattice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.lattice import LatticeKind

FACTOR = 2**0.5  # by which pitches change
FEWEST_PIXELS = 4  # per microlens


def matched(camera: PlenopticCamera) -> PlenopticCamera:
    """The camera with the aperture that fits its microlenses."""
    return replace(camera, main_lens=replace(camera.main_lens, aperture_mm=camera.matched_aperture_mm))


def variants(camera: PlenopticCamera) -> Iterator[tuple[str, PlenopticCamera]]:
    """Names and cameras, their apertures matched anew.

    PMR changes with the pitch of the microlenses, pixels as they are. Finer pixels come with finer microlenses, PMR and
    the sensor's size as they are. The focal lengths of the main lens and of the microlenses stay.
    """
    lattice, sensor, lens = camera.lattice, camera.sensor, camera.main_lens
    pixel = sensor.pixel_pitch_mm
    for factor in (1 / FACTOR, FACTOR):
        pixels = round(camera.pixels_per_microlens * factor)
        if pixels >= FEWEST_PIXELS:
            changed = replace(camera, lattice=replace(lattice, pitch_mm=pixels * pixel))
            yield f"PMR {pixels}", matched(changed)
    for factor in (1 / FACTOR, FACTOR):
        pitch = lattice.pitch_mm * factor
        columns, rows = (round(n / factor) for n in (sensor.columns, sensor.rows))
        finer = replace(sensor, columns=columns, rows=rows, pixel_pitch_mm=pixel * factor)
        changed = replace(camera, lattice=replace(lattice, pitch_mm=pitch), sensor=finer)
        yield f"pitch {1e3 * pitch:.3g} um, pixels {1e3 * pixel * factor:.3g} um", matched(changed)
    for factor in (0.5, 2.0):
        changed = replace(camera, main_lens=replace(lens, magnification=factor * lens.magnification))
        yield f"M = {factor * lens.magnification:.3g}", matched(changed)
    other: LatticeKind = "square" if lattice.kind == "hexagonal" else "hexagonal"
    yield f"{other} lattice", replace(camera, lattice=replace(lattice, kind=other))
