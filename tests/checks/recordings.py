"""Small recordings for the checks: good ones, and what spoils them."""

import shutil

import numpy as np
import tifffile

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.checks import check
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording
from plenopiv.simulation.white import white_image

VELOCITY_M_S = (0.11, -0.06, 0.17)  # 3.2, -1.8 and 1.1 voxels in 0.5 ms
PPM = 1.0


def camera(kind="hexagonal", rotation_rad=0.004, offset_mm=(0.011, -0.023), pmr=14.0, aperture=1.0):
    """The paper's optics on a small sensor; ``aperture`` in matched ones."""
    pitch = pmr * 0.0055
    return PlenopticCamera(
        MainLens(50.0, aperture * 100.0 * pitch / 0.308, -1.0),
        Lattice(kind, pitch, rotation_rad, offset_mm),
        0.308,
        Sensor(392, 364, 0.0055, 12, 60),
    )


def record(
    folder, of=None, velocity_m_s=VELOCITY_M_S, noise=None, orientation="upright", seed=3, x_mm=(-0.7, 0.7), **seeding
):
    return simulate_recording(
        folder,
        of or camera(),
        flow("uniform", velocity_m_s=velocity_m_s),
        dt_s=0.0005,
        volume_mm=(x_mm, (-0.62, 0.62), (-1.6, 1.6)),
        windows=((48, 48, 20), (32, 32, 16)),
        seeding=Seeding(**seeding),
        noise=noise,
        orientation=orientation,
        rays=1500,
        seed=seed,
    ).directory


GOOD = {
    "hexagonal": {},
    "square": {"of": camera("square", -0.006, (0.02, 0.01))},
    "hexagonal turned": {"of": camera(rotation_rad=0.03, offset_mm=(0.03, 0.0))},
    "square, 14.04 px": {"of": camera("square", 0.002, (-0.015, -0.01), pmr=14.04)},
    "dim": {"electrons_per_pixel": 80.0, "noise": SensorNoise(0.5, 5.0)},
    "stored as on the chip": {"orientation": "sensor"},
}


def looked_at(folder, **changes):
    """Check a folder's recording; ``changes`` to its experiment file: ``table__key`` or ``table__table__key``."""
    experiment = Experiment.load(folder / "experiment.toml")
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    for name, value in changes.items():
        *path, key = name.split("__")
        table = tables
        for step in path:
            table = table[step]
        table[key] = value
    changed = Experiment.from_dict(tables, experiment.path)
    return check(changed.recording(), changed.camera(), changed.grid(), changed.correlation.settings())


def wrong(found):
    """What is not good: finding by name."""
    return {finding.name: finding for finding in found.findings if finding.severity != "good"}


def white_of(of, seed=5):
    """The white image of a camera, in counts."""
    return digitise(white_image(of, 3000.0), of.sensor, SensorNoise(), np.random.default_rng(seed))


def copied(folder, to):
    shutil.copytree(folder, to)
    return to


def edited(folder, name, change, **tags):
    """Rewrite an image of the recording, with TIFF tags."""
    path = folder / f"{name}.tif"
    image = tifffile.imread(path)
    tifffile.imwrite(path, np.ascontiguousarray(change(image)).astype(np.uint16), **tags)
    return folder
