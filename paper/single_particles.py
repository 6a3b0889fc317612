"""The paper's Fig. 9a and b: where MART and DRT-MART find a single particle, and how well:  single_particles.py

Particles from z = -2 to 2 mm in steps of 0.077 mm, without noise. Series:

    axis       on the optical axis, as in the paper: a microlens' and a voxel's centre lie on it
    whole      the same in the paper's whole volume, every sixth depth: what the narrower one leaves out
    thinned    the same with faint voxels left out between iterations as runs do, every fourth depth
    areas      DRT-MART on the axis with areas voxel by voxel instead of read off maps ("polygons")
    nine rays  the paper's product on the axis with its nine rays a pixel for weights
    spread     at eight places spread over a microlens, every fourth depth
    noisy      at four of them, one image of each with photon and read noise and a little stray light

Methods: MART, DRT-MART ("bound"), the same with the threshold of high density ("strict"), the paper's "product". All
series but one in a volume of 129 x 129 x 57 voxels about the axis. Writes single-particles.png,
single-particles-quality.png and results/single_particles.json.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from outputs import command_line
from single_particle_figures import draw
from small_camera import ACROSS, CAMERA, LAYOUT, LIGHT, VOXEL_MM, Found, Method, grid, noise_free, reconstructed

from plenopiv.accuracy import exact_volume, intensity_centre_mm, reconstruction_quality
from plenopiv.lightfield import LightField, decode
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import CROWDED, faintest_share, lit_threshold
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.reconstruct import THIN
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import SparseVolume

DEPTHS = tuple(range(-26, 27))  # planes of voxels, 0.077 mm apart
RAYS = 400_000  # of a particle's image
LIT = 1.0  # counts, of some hundreds: a lit pixel
NARROW = 129  # voxels along x and y, 0.71 mm (a particle's light at 2 mm is 0.5 mm wide); (385 - 129)/2 is 2^7, so
# that the points of the projector's maps, a power of two of voxels apart, lie as in the whole volume
WHOLE_MM = (9.0, 9.0, 9.0)  # reach of a centre: all of the volume,
NEAR_MM = (0.1, 0.1, 0.3)  # or what is around the particle
# e^-2 diameters of E0's particle along x, y, z in voxels
EXACT = {
    "gauss": (3.0, 3.0, 3.0),  # Elsinga's, the library's own
    "point": (1e-3, 1e-3, 1e-3),  # all light in the voxel that holds it
    "wide": (9.33, 9.33, 3.0),  # three of the voxels that runs have by default: 51 um, pitch / 4.5 each
}
NOISE, STRAY = SensorNoise(0.5, 3.0), 4.0  # counts per electron and read noise in electrons; electrons in every pixel
Row = dict[str, Any]


def places(count: int) -> NDArray[np.float64]:
    """Halton points (bases 2 and 3) over a microlens seen in the focal plane, (count, 2) mm."""

    def radical(n: int, base: int) -> float:
        return 0.0 if n == 0 else (n % base + radical(n // base, base)) / base

    pitch = CAMERA.lattice.pitch_mm / abs(CAMERA.main_lens.magnification)
    return pitch * (np.array([[radical(n, 2), radical(n, 3)] for n in range(1, count + 1)]) - 0.5)


def row(series: str, method: str, at_mm: NDArray, found: Found) -> Row:
    """Q by every exact volume and centres less the particle's, in mm, of one reconstruction."""
    volume = found.volume.dense()
    centres = {
        name: (intensity_centre_mm(volume, tuple(at_mm), reach) - at_mm).tolist()
        for name, reach in (("whole", WHOLE_MM), ("near", NEAR_MM))
    }
    quality = {
        name: reconstruction_quality(volume, exact_volume([at_mm], 1.0, volume.grid, diameter))
        for name, diameter in EXACT.items()
    }
    about = {"series": series, "method": method, "at_mm": at_mm.tolist(), "started": found.started}
    return about | {"seconds": found.seconds, "off_mm": centres, "q": quality, "spans": spans(found.volume)}


def spans(volume: SparseVolume) -> int:
    """Voxels that hold more than a tenth of the brightest one."""
    return int((volume.values > 0.1 * volume.values.max(initial=0.0)).sum())


def start_of(method: str) -> Method:
    """What ``reconstructed`` calls a method: "strict" is the bound of a crowd."""
    return "mart" if method == "mart" else "product" if method == "product" else "bound"


def faintest_of(method: str, lightfield: LightField, light: float) -> float:
    """The light that a voxel must be able to hold, in counts, where a particle is ``light`` counts."""
    in_focus = light / (pi * CAMERA.aperture_radius_px**2)
    return light * (CROWDED if method == "strict" else faintest_share(lightfield, in_focus))


def rows_of(
    series: str,
    methods: tuple[str, ...],
    at_mm: NDArray,
    lightfield: LightField,
    projector: PlenopticProjector,
    **options,
) -> Iterator[Row]:
    """A particle by each method, from an image without noise."""
    lit = lightfield.values > LIT
    seen = {"lenses": int(lit.any(0).sum()), "pixels": int(lit.sum())}
    for method in methods:
        start, faintest = start_of(method), faintest_of(method, lightfield, LIGHT)
        found = reconstructed(lightfield, projector, start, faintest=faintest, **options)
        yield row(series, method, at_mm, found) | seen


def noisy_rows(at_mm: NDArray, projector: PlenopticProjector, seed: int, rays: int) -> Iterator[Row]:
    """A particle by each method from an image with noise; both are told the noise that the image shows."""
    mean = particle_image(CAMERA, Particles(at_mm[None], np.float64(LIGHT)), rays=rays) + STRAY
    lightfield = decode(digitise(mean, CAMERA.sensor, NOISE, np.random.default_rng(seed)), LAYOUT)
    noise = Noise(dark_noise(lightfield), NOISE.gain)
    lit = lit_threshold(lightfield, noise)
    for method in ("mart", "bound", "product", "strict"):
        start, faintest = start_of(method), faintest_of(method, lightfield, LIGHT * NOISE.gain)
        found = reconstructed(lightfield, projector, start, faintest=faintest, lit=lit, noise=noise)
        yield row("noisy", method, at_mm, found)


def measure(across: int, narrow: int, depths: tuple[int, ...], count: int, rays: int) -> list[Row]:
    """All series at planes ``depths``; ``across`` and ``narrow`` voxels wide, ``count`` places over a microlens."""
    whole, near = PlenopticProjector(LAYOUT, grid(across)), PlenopticProjector(LAYOUT, grid(narrow))
    areas, nine = (PlenopticProjector(LAYOUT, grid(narrow), weights) for weights in ("polygons", "9-rays"))
    three, rows = ("mart", "bound", "product"), list[Row]()
    for depth in depths:
        at = np.array([0.0, 0.0, depth * VOXEL_MM[2]])
        lightfield = noise_free(at, rays)
        rows += rows_of("axis", (*three, "strict"), at, lightfield, near)
        rows += rows_of("areas", three[1:], at, lightfield, areas)
        rows += rows_of("nine rays", three[2:], at, lightfield, nine)
        if depth in depths[::4]:
            rows += rows_of("thinned", three, at, lightfield, near, thin=THIN)
        if depth in depths[2::6]:
            rows += rows_of("whole", three, at, lightfield, whole)
        last = {r["series"] + " " + r["method"]: round(r["q"]["gauss"], 3) for r in rows if r["at_mm"][2] == at[2]}
        print(f"z = {at[2]:+.3f} mm: Q", last, flush=True)
    for depth in depths[::4]:
        for seed, (x, y) in enumerate(places(count)):
            at = np.array([x, y, depth * VOXEL_MM[2]])
            rows += rows_of("spread", (*three, "strict"), at, noise_free(at, rays), near)
            if seed < max(count // 2, 1):
                rows += noisy_rows(at, near, seed, rays)
        print(f"z = {depth * VOXEL_MM[2]:+.3f} mm: {count} places", flush=True)
    return rows


def summary(rows: list[Row]) -> list[Row]:
    """Per series and method outside the dead zone, by half a voxel in depth at least: centres' errors, Q, and at which
    depth DRT-MART's Q less MART's is least."""
    far, near = (z + side * VOXEL_MM[2] / 2 for z, side in zip(CAMERA.dead_zone_mm(), (-1, 1), strict=True))
    outside = [r for r in rows if not far <= r["at_mm"][2] <= near]
    out = []
    for series in dict.fromkeys(r["series"] for r in rows):
        of_series = [r for r in outside if r["series"] == series]
        mart = {tuple(r["at_mm"]): r for r in of_series if r["method"] == "mart"}
        for method in dict.fromkeys(r["method"] for r in of_series):
            each = [r for r in of_series if r["method"] == method]
            off = {name: np.abs([r["off_mm"][name] for r in each]) for name in ("whole", "near")}
            depth = {f"dz_{name}_um": (1e3 * off[name][:, 2].mean(), 1e3 * off[name][:, 2].max()) for name in off}
            lateral = 1e3 * off["near"][:, :2].mean()
            line = {"series": series, "method": method} | depth | {"dxy_near_um": lateral}
            line["q"] = {name: float(np.mean([r["q"][name] for r in each])) for name in EXACT}
            if mart and method != "mart":
                less = {n: [r["q"][n] - mart[tuple(r["at_mm"])]["q"][n] for r in each] for n in EXACT}
                depths = sorted({r["at_mm"][2] for r in each})
                by_depth = {
                    n: [np.mean([v for v, r in zip(less[n], each, strict=True) if r["at_mm"][2] == z]) for z in depths]
                    for n in EXACT
                }
                line["least_gain"] = {
                    n: (float(min(by_depth[n])), float(depths[int(np.argmin(by_depth[n]))])) for n in EXACT
                }
            out.append(line)
    return out


def rounded(value: Any) -> Any:
    """Numbers of a result to 5 decimals, in whatever holds them."""
    if isinstance(value, dict):
        return {key: rounded(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(v) for v in value]
    return round(float(value), 5) if isinstance(value, float) else value


def write(results: Row, target: Path) -> None:
    """JSON with a line for each row."""
    target.parent.mkdir(parents=True, exist_ok=True)
    entries = []
    for key, values in rounded(results).items():
        lines = (
            "[\n" + ",\n".join(map(json.dumps, values)) + "\n]" if key in ("summary", "rows") else json.dumps(values)
        )
        entries.append(f"{json.dumps(key)}: {lines}")
    target.write_text("{\n" + ",\n".join(entries) + "\n}\n")


def main(out: Path, reduced: bool = False) -> None:
    """Measure, print, write JSON and figure into ``out``; ``reduced``: a few depths in a small volume, in seconds."""
    few = (41, 41, (-8, 0, 8), 1, 20_000)
    rows = measure(*few) if reduced else measure(ACROSS, NARROW, DEPTHS, 8, RAYS)
    lines = summary(rows)
    for line in lines:
        print(line, flush=True)
    results = {"dead_zone_mm": CAMERA.dead_zone_mm(), "exact_diameters_voxels": EXACT, "summary": lines, "rows": rows}
    write(results, out / "paper" / "results" / "single_particles.json")
    draw(results, out / "docs" / "images" / "paper")


if __name__ == "__main__":
    command_line(main, __doc__)
