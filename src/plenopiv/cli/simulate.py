"""``plenopiv simulate``: a synthetic recording of an experiment's camera."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import command_line
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import flow
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding, SimulatedRecording, simulate_recording


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
    volume = experiment.volume
    parameters = dict(wanted.parameters)
    if "path" in parameters:
        parameters["path"] = str(experiment.folder / str(parameters["path"]))
    try:
        velocity = flow(wanted.flow, **parameters)
    except (PlenoPIVError, TypeError) as error:
        raise PlenoPIVError(f"{experiment.path}: simulation.{error}") from None
    with Progress() as progress:
        return simulate_recording(
            folder,
            experiment.camera(),
            velocity,
            dt_s=experiment.recording_table.dt_s,
            volume_mm=(volume.x_mm, volume.y_mm, volume.z_mm),
            seeding=Seeding(
                particles_per_microlens=wanted.particles_per_microlens,
                electrons_per_pixel=wanted.electrons_per_pixel,
                electrons_spread=wanted.electrons_spread,
                diameter_mm=wanted.diameter_mm,
                margin_mm=wanted.margin_mm,
            ),
            noise=SensorNoise(wanted.gain, wanted.read_noise_electrons, wanted.shot_noise),
            orientation=experiment.recording_table.orientation,
            wavelength_nm=wanted.wavelength_nm,
            diffraction=wanted.diffraction,
            rays=wanted.rays,
            voxel_mm=volume.voxel_mm,
            windows=experiment.correlation.windows,
            seed=wanted.seed,
            overwrite=overwrite,
            progress=partial(progress, "tracing particles"),
        )
