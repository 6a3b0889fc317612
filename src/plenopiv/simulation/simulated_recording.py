"""A synthetic recording: a folder as a camera's user has it, with the truth beside it.

white.tif  a.tif  b.tif     uint16 counts
optics.json                 what a user knows of the camera
experiment.toml             the program's input file
truth.json                  flow, seed and lattice: what a run never reads
truth_particles.npz         float32 (n, 3) positions in mm in frames ``a`` and ``b``
"""

from __future__ import annotations

import json
import operator
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, told_of
from plenopiv.sensor import Orientation
from plenopiv.simulation.experiment_file import Settings, default_voxel_mm, experiment_toml
from plenopiv.simulation.flows import Velocity, advect, describe
from plenopiv.simulation.images import Progress, particle_image
from plenopiv.simulation.particles import Particles, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.white import white_image
from plenopiv.volume import Limits

COMPLETE = "experiment.toml"  # written last: where it is, the recording is whole
TEXTS, TRUTH = ("optics.json", "truth.json"), "truth_particles.npz"
OURS = re.compile(r"(frame-\d{3,}|run_\d{4,}_[ab])\.tif|truth_particles_\d{4,}\.npz")  # of several frames or pairs


@dataclass(frozen=True)
class Seeding:
    """How the flow is seeded and lit.

    ``margin_mm`` widens the seeded box beyond the volume on every side of x, y and z; None takes half of the largest
    displacement along each axis, so that particles come into the volume and leave it between the frames. The light is
    ``electrons`` per particle, or else ``electrons_per_pixel`` in a pixel lit by a particle in focus, with a relative
    standard deviation of ``electrons_spread`` between particles; ``background_electrons`` is stray light in every pixel
    of a frame. ``diameter_mm``: e^-2 diameter of the particles, 0 for points.
    """

    particles_per_microlens: float = 1.0
    electrons: float | None = None
    electrons_per_pixel: float | None = 400.0
    electrons_spread: float = 0.25
    background_electrons: float = 4.0
    diameter_mm: float = 0.0
    margin_mm: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class WhiteLight:
    """The white image's light: mean electrons of a pixel wholly lit, and the share lost in the corners."""

    electrons_per_pixel: float = 5000.0
    falloff: float = 0.0


@dataclass(frozen=True)
class SimulatedRecording:
    """What was written: the folder, and the particles at the two frames."""

    directory: Path
    a: Particles
    b: Particles
    images: dict[str, NDArray[np.uint16]] = field(repr=False)


def seed_pair(
    camera: PlenopticCamera, flow: Velocity, dt_s: float, volume_mm: Limits, seeding: Seeding, rng: np.random.Generator
) -> tuple[Particles, Particles]:
    """Particles in frames a and b: seeded evenly at mid-time, carried dt/2 back and dt/2 on (RK4).

    So the truth is centred where a correlation's vectors are, and neither frame is the better seeded one.
    """
    margin = seeding.margin_mm
    if margin is None:
        margin = tuple(0.5 * _largest_displacement(flow, dt_s, volume_mm))
    box = tuple((lo - m, hi + m) for (lo, hi), m in zip(volume_mm, margin, strict=True))
    per_pixel = None if seeding.electrons is not None else seeding.electrons_per_pixel
    middle = seed_box(
        camera,
        box,  # type: ignore[arg-type]
        seeding.particles_per_microlens,
        rng,
        electrons=seeding.electrons,
        electrons_per_pixel=per_pixel,
        electrons_spread=seeding.electrons_spread,
        diameter_mm=seeding.diameter_mm,
    )
    a = advect(flow, middle.position_mm, -0.5 * dt_s)
    b = advect(flow, middle.position_mm, 0.5 * dt_s)
    return middle.moved_to(a), middle.moved_to(b)


def _largest_displacement(flow: Velocity, dt_s: float, volume_mm: Limits, n: int = 17) -> NDArray[np.float64]:
    """Largest |displacement| in mm along each axis over a grid of the volume."""
    axes = np.meshgrid(*(np.linspace(lo, hi, n) for lo, hi in volume_mm), indexing="ij")
    return np.abs(flow(np.stack(axes, -1).reshape(-1, 3))).max(0) * 1e3 * dt_s


def simulate_recording(
    directory: str | Path,
    camera: PlenopticCamera,
    flow: Velocity,
    *,
    dt_s: float,
    volume_mm: Limits,
    seeding: Seeding | None = None,
    particles: tuple[Particles, Particles] | None = None,
    noise: SensorNoise | None = None,
    white: WhiteLight | None = None,
    orientation: Orientation = "upright",
    wavelength_nm: float = 532.0,
    diffraction: bool = True,
    rays: int = 20_000,
    voxel_mm: tuple[float, float, float] | None = None,
    windows: tuple[tuple[int, int, int], ...] = ((128, 128, 32), (64, 64, 16)),
    drift: ArrayDrift | None = None,
    settings: Settings | None = None,
    seed: int = 0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SimulatedRecording:
    """Simulate a pair of frames and the white image, and write the recording's folder.

    ``flow``: velocity in m/s at (n, 3) mm, steady during ``dt_s``. ``volume_mm``: the limits ((x), (y), (z)) that
    ``experiment.toml`` asks to reconstruct; the seeded box is that and a margin (``Seeding``). ``particles``: given
    positions in the two frames instead of seeded ones. ``voxel_mm`` as in ``default_voxel_mm`` unless given.
    ``windows`` are copied to the file, and so are ``settings``, tables of reconstruction, correlation, tracking and
    output by name, where given. ``rays`` per particle; ``diffraction`` blurs by the microlenses at
    ``wavelength_nm``. The lattice, with its rotation and offset, is the camera's, and in the frames what ``drift`` has
    made of it. Everything follows from ``seed``.
    ``progress(done, total)`` counts the particles of both frames.

    Files are written aside and renamed, experiment.toml last. Raises PlenoPIVError when the folder already holds a
    recording, or one of the files, and ``overwrite`` is not set, and for settings out of range.
    """
    seed, out = checked_seed(dt_s, seed), checked_folder(directory, ("white.tif", "a.tif", "b.tif"), overwrite)
    seeding, noise, white = seeding or Seeding(), noise or SensorNoise(), white or WhiteLight()
    # one stream for each purpose: changing the noise leaves the particles where they are
    seeding_rng, *noise_rngs = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    a, b = particles or seed_pair(camera, flow, dt_s, volume_mm, seeding, seeding_rng)
    diffraction_nm = wavelength_nm if diffraction else None

    flat = white_image(camera, white.electrons_per_pixel, falloff=white.falloff, diffraction_nm=diffraction_nm)
    images = {"white": digitise(flat, camera.sensor, noise, noise_rngs[0], orientation)}
    del flat  # a quarter of a gigabyte at full size
    total, now = len(a.electrons) + len(b.electrons), (drift or ArrayDrift()).of(camera)
    for k, (name, frame) in enumerate((("a", a), ("b", b))):
        light = particle_image(
            now,
            frame,
            rays=rays,
            seed=2 * seed + k,
            diffraction_nm=diffraction_nm,
            progress=counted(progress, k * len(a.electrons), total),
        )
        light += seeding.background_electrons
        images[name] = digitise(light, camera.sensor, noise, noise_rngs[1 + k], orientation)

    name, parameters = describe(flow)
    lattice = camera.lattice
    truth = {
        "flow": name,
        "seed": seed,
        "lattice_rotation_deg": degrees(lattice.rotation_rad),
        "lattice_offset_mm": list(lattice.offset_mm),
        "particles": len(a.electrons),
        "flow_parameters": parameters,
        "electrons_per_particle": float(np.mean(a.electrons)) if len(a.electrons) else 0.0,
        "gain_counts_per_electron": noise.gain,
        "read_noise_electrons": noise.read_noise_electrons,
        "background_electrons": seeding.background_electrons,
        **({"drift": asdict(drift)} if drift else {}),
    }
    texts = {
        "optics.json": as_json(
            optics_sheet(camera, orientation, dt_s, wavelength_nm, seeding.particles_per_microlens, volume_mm)
        ),
        "truth.json": as_json(truth),
        COMPLETE: experiment_toml(
            camera, orientation, dt_s, volume_mm, voxel_mm or default_voxel_mm(camera), windows, settings=settings
        ),
    }
    write_folder(out, images, {"truth_particles": of_pair(a, b)}, texts)
    return SimulatedRecording(out, a, b, images)


def checked_folder(directory: str | Path, images: Iterable[str], overwrite: bool) -> Path:
    """The folder of a recording of these ``images``.

    Raises:
        PlenoPIVError: it holds a recording already, or a file that would be replaced, and ``overwrite`` is not set; or
            it cannot be made.
    """
    out = Path(directory)
    if (out / COMPLETE).exists() and not overwrite:
        raise PlenoPIVError(f"{out}: holds a recording already, choose another folder or pass --overwrite")
    there = [name for name in (*images, *TEXTS, TRUTH) if (out / name).exists()]
    if there and not overwrite:  # raw images of a camera may have these names
        raise PlenoPIVError(f"{out / there[0]}: is there; choose another folder, or pass --overwrite and it is lost")
    above = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        why = "cannot be written to" if above.is_dir() else "is no folder"
        raise PlenoPIVError(f"{out}: cannot be made, {above} {why}; choose another folder")
    return out


def checked_seed(dt_s: float, seed: int) -> int:
    """The seed as a number of Python: one of NumPy would overflow where seeds of images are made of it.

    Raises:
        PlenoPIVError: settings are out of range.
    """
    if not dt_s > 0:
        raise PlenoPIVError(f"simulation: dt_s = {dt_s}, give the time between frames in seconds")
    if seed < 0:
        raise PlenoPIVError(f"simulation: seed = {seed}, give 0 or a positive whole number")
    return operator.index(seed)


def counted(progress: Progress | None, before: int, total: int) -> Callable[[int, int], None] | None:
    """Progress over one frame as progress over both."""
    return None if progress is None else lambda done, _: progress(before + done, total)


def optics_sheet(
    camera: PlenopticCamera, orientation: Orientation, dt_s: float, wavelength_nm: float, ppm: float, volume_mm: Limits
) -> dict[str, Any]:
    """What a user knows of the camera, the recording and its seeding, for ``optics.json``."""
    lens, sensor = camera.main_lens, camera.sensor
    return {
        "main_lens": {
            "focal_length_mm": lens.focal_length_mm,
            "aperture_mm": lens.aperture_mm,
            "object_distance_mm": lens.object_distance_mm,
            "image_distance_mm": lens.image_distance_mm,
            "magnification": lens.magnification,
        },
        "microlens_array": {
            "lattice": camera.lattice.kind,
            "pitch_mm": camera.lattice.pitch_mm,
            "focal_length_mm": camera.microlens_focal_length_mm,
        },
        "sensor": {
            "columns": sensor.columns,
            "rows": sensor.rows,
            "pixel_pitch_mm": sensor.pixel_pitch_mm,
            "bits": sensor.bit_depth,
            "black_level": sensor.black_level,
        },
        "recording": {"orientation": orientation, "dt_s": dt_s, "wavelength_nm": wavelength_nm},
        "seeding": {"particles_per_microlens": ppm, "depth_mm": list(volume_mm[2])},
    }


def as_json(content: dict[str, Any]) -> str:
    """Content of a JSON file; numbers and arrays of NumPy become numbers and lists, anything else text."""
    return json.dumps(
        content, indent=2, default=lambda v: v.tolist() if isinstance(v, np.generic | np.ndarray) else str(v)
    )


def of_pair(a: Particles, b: Particles) -> dict[str, NDArray]:
    """The truth of a pair, for ``write_folder``."""
    return {"a": a.position_mm.astype(np.float32), "b": b.position_mm.astype(np.float32)}


def write_folder(
    out: Path,
    images: dict[str, NDArray[np.uint16]],
    truth: Mapping[str, Mapping[str, NDArray]],
    texts: dict[str, str],
) -> None:
    """Write every file aside, then rename them, the one that says "complete" last. Where a simulated recording is
    replaced its other frames are removed: patterns of the new one would meet them.

    ``images`` by name, without ``.tif``; ``truth``: arrays by name, by name of their file without ``.npz``; ``texts``
    by file name.

    Raises:
        PlenoPIVError: a file cannot be written, as on a full disk; nothing is left behind.
    """
    with told_of(out):
        out.mkdir(parents=True, exist_ok=True)
    parts: list[tuple[Path, Path]] = []
    try:
        for name, image in images.items():
            with _aside(out / f"{name}.tif", parts) as part:
                tifffile.imwrite(part, image, compression="adobe_deflate", predictor=True)
        for name, arrays in truth.items():
            with _aside(out / f"{name}.npz", parts) as part, open(part, "wb") as f:
                np.savez_compressed(f, **arrays)  # type: ignore[arg-type]
        for name in sorted(texts, key=lambda n: n == COMPLETE):
            with _aside(out / name, parts) as part:
                part.write_text(texts[name] + "\n")
        with told_of(out):
            _into_place(out, parts)
    finally:
        for part, _ in parts:
            with suppress(OSError):
                part.unlink()


@contextmanager
def _aside(final: Path, parts: list[tuple[Path, Path]]) -> Iterator[Path]:
    """Where to write what shall become ``final``, which ``parts`` then lists."""
    parts.append((final.with_name(f".{final.name}.part"), final))
    with told_of(final):
        yield parts[-1][0]


def _into_place(out: Path, parts: list[tuple[Path, Path]]) -> None:
    (out / COMPLETE).unlink(missing_ok=True)
    if (out / "truth.json").exists():
        for path in set(out.iterdir()) - {final for _, final in parts}:
            if OURS.fullmatch(path.name):
                path.unlink()
    for part, final in parts:
        os.replace(part, final)
