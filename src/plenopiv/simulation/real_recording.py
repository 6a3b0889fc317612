"""A recording of a real camera as its user has it: images of a target, pairs of frames, and what goes with them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.sensor import Orientation
from plenopiv.simulation.experiment_file import FRAMES, Settings, default_voxel_mm, experiment_toml
from plenopiv.simulation.flows import Velocity, describe
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.patches import Progress
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import SAMPLES, real_particle_image, real_white_image, sight_lines, target_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import (
    COMPLETE,
    Seeding,
    WhiteLight,
    as_json,
    checked_folder,
    checked_seed,
    counted,
    of_pair,
    optics_sheet,
    seed_pair,
    write_folder,
)
from plenopiv.simulation.targets import DotTarget
from plenopiv.volume import Limits

OURS = ("white", "a", "b", "dark", "background_a", "background_b")  # images that a recording has besides
MEAN_OF = 20  # frames that dark image and images of static light are the mean of

ESCAPED = '"\\\\'  # in texts of the experiment file

Counts = NDArray[np.uint16]


@dataclass(frozen=True)
class TargetPlanes:
    """Images of a target at ``z_mm`` of the laboratory; ``electrons_per_pixel`` in a pixel that sees only a dot.
    ``names``: of their files, NAME.tif without a folder, else target_00.tif, target_01.tif ...; ``samples``: rays of
    each pixel.

    Raises PlenoPIVError for names of another kind, or one for two images.
    """

    target: DotTarget
    z_mm: tuple[float, ...]
    electrons_per_pixel: float = 3000.0
    names: tuple[str, ...] | None = None
    samples: int = 2 * SAMPLES

    def __post_init__(self) -> None:
        files = self.files()
        for name in files:
            # all images lie in the recording's folder, as TIFF files
            odd = not name.isprintable() or set(name) & set(ESCAPED)
            if odd or Path(name).name != name or Path(name).suffix != ".tif" or Path(name).stem in OURS:
                raise PlenoPIVError(
                    f"simulation: '{printable(name)}' cannot be the file of a target; give NAME.tif without a folder, "
                    f"and none of {', '.join(OURS)}"
                )
        if len(set(files)) < len(files):
            raise PlenoPIVError(f"simulation: {', '.join(files)} name one file for two targets; give each another name")

    def files(self) -> tuple[str, ...]:
        """Names of the images."""
        return self.names or tuple(f"target_{k:02d}.tif" for k in range(len(self.z_mm)))


@dataclass(frozen=True)
class Extras:
    """What a recording has beside white image and frames.

    ``second_pulse``: light of the second frame of a pair, as a share of the first's. ``static_light``: mean electrons
    (rows, columns), upright, without particles, of the first and of the second pulse, None for none: then
    background_a.tif and background_b.tif are made too. ``dark``: whether there is a dark image.
    """

    targets: TargetPlanes | None = None
    second_pulse: float = 1.0
    static_light: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    dark: bool = False


@dataclass(frozen=True)
class RealRecording:
    """What was written: the folder, the particles (first, second frame) of each pair, and the images by name."""

    directory: Path
    pairs: tuple[tuple[Particles, Particles], ...]
    images: dict[str, Counts] = field(repr=False)


def data_sheet(camera: RealCamera) -> PlenopticCamera:
    """The thin-lens camera that a right data sheet states; its aperture is the entrance pupil's."""
    lens = MainLens(
        camera.focal_length_mm,
        2.0 * camera.entrance_pupil_mm[1],
        -camera.image_distance_mm / camera.object_distance_mm,
    )
    return PlenopticCamera(lens, camera.lattice, camera.microlens_focal_length_mm, camera.sensor, None, camera.blur_mm)


def simulate_real_recording(
    directory: str | Path,
    camera: RealCamera,
    flow: Velocity,
    *,
    dt_s: float,
    volume_mm: Limits,
    pairs: int = 1,
    extras: Extras | None = None,
    sheet: PlenopticCamera | None = None,
    medium_known: bool = True,
    seeding: Seeding | None = None,
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
) -> RealRecording:
    """Simulate pairs of frames, white image and what ``extras`` ask for, and write the recording's folder.

    As ``simulate_recording``, with a real camera: ``flow``, ``volume_mm`` and the particles are in the laboratory's
    frame; ``drift`` is of the frames alone, not of white image and target. ``sheet``: the camera that the experiment
    file states, by default ``data_sheet``; ``medium_known``: whether the file states fluid and window. One pair is
    a.tif and b.tif, several are run_0001_a.tif, run_0001_b.tif ..., their particles truth_particles.npz or
    truth_particles_0001.npz ...

    Raises PlenoPIVError as ``simulate_recording`` does, and where particles or targets are not in the fluid.
    """
    seed = checked_seed(dt_s, seed)
    if pairs < 1:
        raise PlenoPIVError(f"simulation: pairs = {pairs}, give at least one")
    frames = [name for number in range(1, pairs + 1) for name in _frame_names(number, pairs)]
    files = () if extras is None or extras.targets is None else extras.targets.files()
    out = checked_folder(directory, (*(f"{name}.tif" for name in (*OURS, *frames)), *files), overwrite)
    extras, seeding, noise = extras or Extras(), seeding or Seeding(), noise or SensorNoise()
    white, true_sheet = white or WhiteLight(), data_sheet(camera)
    diffraction_nm = wavelength_nm if diffraction else None
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2 + pairs)]
    light_rng, target_rng, *pair_rngs = rngs

    def counts(electrons: NDArray[np.float64], rng: np.random.Generator, frames: int = 1) -> Counts:
        """Counts of one frame, or the mean of several."""
        taken = [digitise(electrons, camera.sensor, noise, rng, orientation) for _ in range(frames)]
        return taken[0] if frames == 1 else np.rint(np.mean(taken, 0)).astype(np.uint16)

    flat = real_white_image(
        camera, white.electrons_per_pixel, falloff=white.falloff, diffraction_nm=diffraction_nm, seed=seed
    )
    images = {"white": counts(flat, light_rng)}
    static = extras.static_light or (np.zeros_like(flat),) * 2
    if extras.dark:
        images["dark"] = counts(np.zeros_like(flat), light_rng, MEAN_OF)
    if extras.static_light is not None:
        for name, light in zip("ab", static, strict=True):
            images[f"background_{name}"] = counts(light + seeding.background_electrons, light_rng, MEAN_OF)
    if (planes := extras.targets) is not None:
        for k, (name, z) in enumerate(zip(planes.files(), planes.z_mm, strict=True)):
            light = target_image(
                camera, planes.target, z, planes.electrons_per_pixel,
                diffraction_nm=diffraction_nm, samples=planes.samples, seed=seed + k,
            )  # fmt: skip
            images[Path(name).stem] = counts(light, target_rng)

    now = replace(camera, lattice=drift.of(true_sheet).lattice) if drift else camera
    moved: dict[str, tuple[Particles, Particles]] = {}
    for number, rng in enumerate(pair_rngs, 1):
        a, b = seed_pair(true_sheet, flow, dt_s, volume_mm, seeding, rng)
        moved["truth_particles" if pairs == 1 else f"truth_particles_{number:04d}"] = a, b
        total = 2 * pairs * len(a.electrons)
        for k, frame in enumerate((a, b)):
            before = (2 * (number - 1) + k) * len(a.electrons)
            light = real_particle_image(
                now,
                frame,
                rays=rays,
                seed=2 * (seed + (number - 1) * 7919) + k,
                diffraction_nm=diffraction_nm,
                progress=counted(progress, before, total),
            )
            light *= extras.second_pulse if k else 1.0
            light += seeding.background_electrons + static[k]
            images[_frame_names(number, pairs)[k]] = counts(light, rng)

    flow_name, parameters = describe(flow)
    truth = {
        "flow": flow_name,
        "flow_parameters": parameters,
        "seed": seed,
        "pairs": pairs,
        "particles": [len(a.electrons) for a, _ in moved.values()],
        "camera": asdict(camera),
        "object_distance_mm": camera.object_distance_mm,
        "exit_pupil_to_microlenses_mm": camera.exit_pupil_mm if isfinite(camera.exit_pupil_mm) else None,
        "air_mm": camera.air_mm,
        "second_pulse": extras.second_pulse,
        "gain_counts_per_electron": noise.gain,
        "read_noise_electrons": noise.read_noise_electrons,
        "background_electrons": seeding.background_electrons,
        **({"drift": asdict(drift)} if drift else {}),
    }
    stated, medium = sheet or true_sheet, camera.medium
    index = 1.0 if medium is None else medium.refractive_index
    known = optics_sheet(stated, orientation, dt_s, wavelength_nm, seeding.particles_per_microlens, volume_mm)
    if medium is not None:
        known["medium"] = asdict(medium)
    x, y, voxel_z = default_voxel_mm(stated)
    text = experiment_toml(
        stated, orientation, dt_s, volume_mm, voxel_mm or (x, y, round(voxel_z * index, 10)), windows,
        tables=_tables(medium if medium_known else None, extras.targets), images=_image_lines(extras, pairs),
        seen_mm=_seen_mm(camera, volume_mm, index), settings=settings,
    )  # fmt: skip
    texts = {"optics.json": as_json(known), "truth.json": as_json(truth), COMPLETE: text}
    write_folder(out, images, {name: of_pair(*pair) for name, pair in moved.items()}, texts)
    return RealRecording(out, tuple(moved.values()), images)


def _frame_names(number: int, pairs: int) -> tuple[str, str]:
    """Of the two frames of a pair, by its number from 1."""
    return ("a", "b") if pairs == 1 else (f"run_{number:04d}_a", f"run_{number:04d}_b")


def _seen_mm(camera: RealCamera, volume_mm: Limits, index: float) -> Limits:
    """A volume of the laboratory as a thin lens in air sees it, to first order."""
    point, direction = sight_lines(camera, (0.0, 0.0), (0.0, 0.0))
    x0, y0, _ = (point - direction * (point[:, 2:] / direction[:, 2:]))[0].tolist()
    x, y, z = volume_mm
    near = camera.pose.origin_mm[2]
    return (x[0] - x0, x[1] - x0), (y[0] - y0, y[1] - y0), ((z[0] + near) / index, (z[1] + near) / index)


def _tables(medium: Medium | None, planes: TargetPlanes | None) -> str:
    """[medium] and [calibration] of the experiment file."""
    lines: list[str] = []
    if medium is not None:
        lines += [
            "",
            "[medium]                       # z = 0 is in the fluid",
            f"refractive_index = {float(medium.refractive_index)!r}",
            f"fluid_mm = {float(medium.fluid_mm)!r}           # from z = 0 to the window's inner face",
            f"window_mm = {float(medium.window_mm)!r}",
            f"window_refractive_index = {float(medium.window_refractive_index)!r}",
            f"window_tilt_deg = {[float(t) for t in medium.window_tilt_deg]}   # about x, about y",
        ]
    if planes is not None:
        target = planes.target
        sizes: dict[str, Any] = {"origin_dot_mm": target.origin_dot_mm, "x_dot_mm": target.x_dot_mm}
        lines += ["", "[calibration]                  # x, y, z are the target's", 'target = "dots"']
        lines += [f"pitch_mm = {float(target.pitch_mm)!r}", f"dot_mm = {float(target.dot_mm)!r}"]
        if target.step_mm:
            lines.append(f"step_mm = {float(target.step_mm)!r}")
        lines += [f"{key} = {float(size)!r}" for key, size in sizes.items() if size is not None]
        shown = zip(planes.files(), planes.z_mm, strict=True)
        lines += ["planes = [", *(f'    {{ image = "{n}", z_mm = {float(z)!r} }},' for n, z in shown), "]"]
    return "\n".join([*lines, ""]) if lines else ""


def _image_lines(extras: Extras, pairs: int) -> str:
    """Lines of [recording] that name images."""
    lines = [FRAMES if pairs == 1 else 'pairs = "run_*_{a,b}.tif"']
    if extras.dark:
        lines.append('dark = "dark.tif"')
    if extras.static_light is not None:
        lines.append('background = ["background_a.tif", "background_b.tif"]')
    return "\n".join(lines)
