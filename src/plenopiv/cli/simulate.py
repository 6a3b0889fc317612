"""``plenopiv simulate``: a synthetic recording of an experiment's camera."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import command_line
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import flow
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_recording import Extras, TargetPlanes, simulate_real_recording
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding, SimulatedRecording, simulate_recording
from plenopiv.simulation.targets import CutDot, DotTarget


def simulate(file: Path, folder: Path, overwrite: bool) -> str:
    """Write the recording; returns its files and the next command.

    Raises:
        PlenoPIVError: the experiment file is wrong or has no [simulation] table, the flow or its parameters are
            unknown, or the folder already holds a recording.
    """
    recording = recorded(Experiment.load(file), folder, overwrite)
    target = recording.directory / "experiment.toml"
    return (
        f"{recording.directory}: {len(recording.a.position_mm)} particles in frames a.tif and b.tif, white.tif, and "
        f"the truth in truth.json and truth_particles.npz\nNext: {command_line('run', target)}"
    )


def recorded(experiment: Experiment, folder: Path, overwrite: bool) -> SimulatedRecording:
    """The synthetic recording of an experiment, written to ``folder``.

    Raises:
        PlenoPIVError: as ``simulate`` does.
    """
    wanted = experiment.simulation
    if wanted is None:
        raise PlenoPIVError(f"{experiment.path}: has no [simulation] table; plenopiv simulate --help shows one")
    if folder.resolve() == experiment.folder.resolve():
        raise PlenoPIVError(f"{folder}: holds the experiment file itself; name another folder for the recording")
    if wanted.pose is not None and experiment.calibration is None:
        raise PlenoPIVError(
            f"{experiment.path}: simulation.pose: places a target, and there is none; add [calibration], or leave the "
            "pose out: a run would take the volume for the camera's"
        )
    _warn_of_what_is_left_out(experiment)
    volume = experiment.volume
    parameters = dict(wanted.parameters)
    if "path" in parameters:
        parameters["path"] = str(experiment.folder / str(parameters["path"]))
    try:
        velocity = flow(wanted.flow, **parameters)
    except (PlenoPIVError, TypeError) as error:
        raise PlenoPIVError(f"{experiment.path}: simulation.{error}") from None
    seeding = Seeding(
        particles_per_microlens=wanted.particles_per_microlens,
        electrons_per_pixel=wanted.electrons_per_pixel,
        electrons_spread=wanted.electrons_spread,
        diameter_mm=wanted.diameter_mm,
        margin_mm=wanted.margin_mm,
    )
    with Progress() as progress:
        settings: dict[str, Any] = {
            "dt_s": experiment.recording_table.dt_s,
            "volume_mm": (volume.x_mm, volume.y_mm, volume.z_mm),
            "seeding": seeding,
            "noise": SensorNoise(wanted.gain, wanted.read_noise_electrons, wanted.shot_noise),
            "orientation": experiment.recording_table.orientation,
            "wavelength_nm": wanted.wavelength_nm,
            "diffraction": wanted.diffraction,
            "rays": wanted.rays,
            "voxel_mm": volume.voxel_mm,
            "windows": experiment.correlation.windows,
            "drift": None if wanted.drift is None else ArrayDrift(**wanted.drift.model_dump()),
            "settings": _settings(experiment),
            "seed": wanted.seed,
            "overwrite": overwrite,
            "progress": partial(progress, "tracing particles"),
        }
        if not _is_real(experiment):
            return simulate_recording(folder, experiment.camera(), velocity, **settings)
        extras = Extras(_targets(experiment), dark=wanted.dark)
        try:
            made = simulate_real_recording(
                folder, real_camera(experiment), velocity, sheet=experiment.camera(), extras=extras, **settings
            )
        except PlenoPIVError as error:
            raise PlenoPIVError(f"{experiment.path}: {error}") from None
        return SimulatedRecording(made.directory, *made.pairs[0], made.images)


def _warn_of_what_is_left_out(experiment: Experiment) -> None:
    named = {"volume.body": experiment.volume.body, "recording.mask": experiment.recording_table.mask}
    if left_out := [key for key, name in named.items() if name]:
        warnings.warn(
            f"{experiment.path}: {' and '.join(left_out)}: not simulated, and left out of the recording",
            PlenoPIVWarning,
            stacklevel=2,
        )


def _settings(experiment: Experiment) -> dict[str, Any]:
    """The tables of what is done with images, as the file states them."""
    stated = experiment.model_dump(by_alias=True, exclude_unset=True, exclude_none=True)
    return {name: stated[name] for name in ("reconstruction", "correlation", "tracking", "output") if name in stated}


def _is_real(experiment: Experiment) -> bool:
    """Whether the file asks for more than a thin lens in air."""
    wanted = experiment.simulation
    assert wanted is not None
    asked = (experiment.medium, experiment.calibration, wanted.optics, wanted.pose, wanted.target, wanted.dark or None)
    return any(table is not None for table in asked)


def real_camera(experiment: Experiment) -> RealCamera:
    """The camera of a file with all that [medium] and the tables of [simulation] say of it.

    Raises:
        PlenoPIVError: they do not go together.
    """
    wanted, medium = experiment.simulation, experiment.medium
    optics = {} if wanted is None or wanted.optics is None else wanted.optics.model_dump()
    pose = {} if wanted is None or wanted.pose is None else wanted.pose.model_dump()
    known = None if medium is None else medium.medium()
    return RealCamera.of(experiment.camera(), **optics, medium=known, pose=Pose(**pose))


def _targets(experiment: Experiment) -> TargetPlanes | None:
    """The target of [calibration], with what [simulation.target] adds, at its planes."""
    table, wanted = experiment.calibration, experiment.simulation
    if table is None:
        return None
    more = {} if wanted is None or wanted.target is None else wanted.target.model_dump()
    light = {"electrons_per_pixel": more.pop("electrons_per_pixel")} if more else {}
    cut = tuple(CutDot(**dot) for dot in more.pop("cut", ()))
    sizes = table.model_dump(include={"pitch_mm", "dot_mm", "origin_dot_mm", "x_dot_mm", "step_mm"})
    names = tuple(plane.image for plane in table.planes)
    z_mm = tuple(plane.z_mm for plane in table.planes)
    return TargetPlanes(DotTarget(**sizes, **more, cut=cut), z_mm, names=names, **light)
