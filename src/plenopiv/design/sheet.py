"""What a camera will do, before it is built: resolution, field, seeding and, from its twin, velocity errors."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite, pi
from typing import Any, NamedTuple

import numpy as np

from plenopiv.cameras.consistency import contradictions, mismatch
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.design.advice import Measurement, suggested
from plenopiv.design.light_columns import fan_mm
from plenopiv.design.resolution import mean_free_shift
from plenopiv.design.twin import Progress, Twin, twin
from plenopiv.design.variants import variants
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.simulation.simulated_recording import Seeding

DEPTHS = 17  # of a table


class Depth(NamedTuple):
    """At a depth: the full width and height that every view sees, and how far a point moves in the mean, and at most,
    before another pixel is lit (``resolution``), across (y) and in depth (z). Lengths in mm."""

    z_mm: float
    field_mm: tuple[float, float]
    across_mm: float
    across_largest_mm: float
    in_depth_mm: float
    in_depth_largest_mm: float


@dataclass(frozen=True)
class Optics:
    """A camera in numbers that follow from its geometry.

    ``microlenses`` on the sensor, ``views`` pixels that a microlens lights, ``dead_zone_mm`` where depth is not
    resolved, ``overlap`` particles that light a pixel at one per microlens, in the mean over ``depths``.
    """

    name: str
    camera: PlenopticCamera
    measurement: Measurement
    microlenses: int
    views: int
    dead_zone_mm: tuple[float, float]
    overlap: float
    depths: tuple[Depth, ...]


@dataclass(frozen=True)
class Design:
    """A camera, what changes with it, and its twins at several densities of particles."""

    optics: Optics
    variants: tuple[Optics, ...]
    twins: tuple[Twin, ...]
    variant_twins: tuple[Twin | None, ...]

    @property
    def best(self) -> Twin | None:
        """The twin with the least error, its components counted in voxels; None without twins."""
        return min(self.twins, key=_badness, default=None)

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain dictionaries and numbers, for JSON."""
        return asdict(self)


def _badness(twin: Twin) -> float:
    """Sum of the squares of a twin's errors; infinite where one is not known."""
    found = sum(e**2 for e in twin.errors.rms)
    return found if isfinite(found) else inf


def design(
    camera: PlenopticCamera,
    depth_mm: tuple[float, float] | None = None,
    *,
    densities: Sequence[float] = (),
    simulate_variants: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Design:
    """Resolution, field, variants and expected errors of a camera.

    ``depth_mm``: what is lit, default where the camera resolves depth well. ``densities``: particles per microlens,
    each simulated in a twin; none leave velocity errors out, and one of which no velocity comes is warned of.
    ``simulate_variants``: a twin of each variant too, at the density of the best one.

    Raises:
        PlenoPIVError: the optics contradict one another, the aperture over- or underfills the microlenses, the depth
            is empty or holds the main lens; no velocity comes of any density.
    """
    wrong = contradictions(camera)
    unmatched = mismatch(camera)
    if wrong or unmatched:
        raise PlenoPIVError(wrong[0] if wrong else f"main_lens.aperture_mm: {unmatched}")
    base = optics(camera, depth_mm, "as given")
    others, other_twins = [], list[Twin | None]()
    twins = _twins(camera, base.measurement, densities, seed, progress)
    best = min(twins, key=_badness, default=None)
    seeding = Seeding() if best is None else Seeding(particles_per_microlens=best.particles_per_microlens)
    for name, other in variants(camera):
        try:
            if contradictions(other):
                continue
            found = optics(other, depth_mm and _scaled(depth_mm, camera, other), name)
        except PlenoPIVError:  # a variant that sees nothing of the depth is no advice
            continue
        others.append(found)
        if simulate_variants:
            other_twins.append(_twin(other, found.measurement, seeding, seed, progress, name))
    return Design(base, tuple(others), tuple(twins), tuple(other_twins))


def _twins(
    camera: PlenopticCamera, measured: Measurement, densities: Sequence[float], seed: int, progress: Progress | None
) -> list[Twin]:
    """The twins of which velocities come."""
    made = [
        _twin(
            camera, measured, Seeding(particles_per_microlens=ppm), seed, progress, f"{ppm:g} particles per microlens"
        )
        for ppm in densities
    ]
    found = [each for each in made if each is not None]
    if made and not found:
        raise PlenoPIVError(
            "no velocity comes of any of these densities; give others with --density, another --depth, or --no-simulate"
        )
    return found


def _twin(
    camera: PlenopticCamera, measured: Measurement, seeding: Seeding, seed: int, progress: Progress | None, name: str
) -> Twin | None:
    """A twin; None, with a warning, where no velocity comes of it."""
    try:
        return twin(camera, measured, seeding=seeding, seed=seed, progress=progress)
    except PlenoPIVError as error:
        warnings.warn(f"{name}: is left out ({error})", PlenoPIVWarning, stacklevel=4)
        return None


def _scaled(depth_mm: tuple[float, float], camera: PlenopticCamera, other: PlenopticCamera) -> tuple[float, float]:
    """The same depth for another magnification: it goes with 1/M^2, as depth resolution does."""
    factor = (camera.main_lens.magnification / other.main_lens.magnification) ** 2
    return depth_mm[0] * factor, depth_mm[1] * factor


def optics(camera: PlenopticCamera, depth_mm: tuple[float, float] | None = None, name: str = "camera") -> Optics:
    """The numbers of a camera that follow from its geometry. Errors as ``advice.suggested``."""
    measurement = suggested(camera, depth_mm)
    z = np.linspace(*measurement.limits_mm[2], DEPTHS)
    field = np.stack(seen_by_every_view_mm(camera, z), 1)
    rays = fan_mm(camera)
    across, depth = (mean_free_shift(camera, z, e, rays) for e in ((0, 1, 0), (0, 0, 1)))
    rows = zip(z, field, across.mean_mm, across.largest_mm, depth.mean_mm, depth.largest_mm, strict=True)
    return Optics(
        name,
        camera,
        measurement,
        microlenses=round(camera.microlenses),
        views=round(pi * camera.aperture_radius_px**2),
        dead_zone_mm=camera.dead_zone_mm(),
        overlap=overlap(camera, measurement.limits_mm[2]),
        depths=tuple(Depth(float(at), (2 * float(f[0]), 2 * float(f[1])), *map(float, r)) for at, f, *r in rows),
    )


def overlap(camera: PlenopticCamera, depth_mm: tuple[float, float], samples: int = 101) -> float:
    """Particles that light a pixel at one per microlens: the footprint of a portion, |A| P_m/PMR wide, and a microlens,
    over the cell of a microlens, in the mean over depth. 1 in focus."""
    pitch = camera.lattice.pitch_mm
    wide = np.abs(camera.spread(np.linspace(*depth_mm, samples))) * camera.portion_mm
    return float(np.mean((1 + wide / pitch) ** 2))
