"""The reports that the browser sees: the demo's, one of a rotation before another camera, one of a recording."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import plenopiv
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import write_velocity
from plenopiv.lattice import Lattice
from plenopiv.report import series_of_file, write_report
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

ROOT = Path(__file__).parents[2]
OVER_TIME = ("replaced_share", "median_peak_ratio", "largest_velocity_m_s")
SERIES = """
[camera]
kind = "plenoptic"
main_lens = { focal_length_mm = 50.0, aperture_mm = 25.0, magnification = -1.0 }
microlens_array = { lattice = "hexagonal", pitch_mm = 0.077, focal_length_mm = 0.308 }
sensor = { columns = 700, rows = 560, pixel_pitch_mm = 0.0055, bit_depth = 12 }
[recording]
white = "white.tif"
pairs = "run_*_{a,b}.tif"
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-1.5, 1.5]
y_mm = [-1.1, 1.1]
z_mm = [-2.0, 2.0]
voxel_mm = [0.0171428571, 0.0171428571, 0.077]
[correlation]
windows = [[48, 48, 16]]
"""


def demo(folder):
    """As ``make demo`` left it."""
    path = ROOT / "demo" / "results" / "report.html"
    if not path.exists():
        pytest.skip(f"{path} is missing: make demo")
    return path


def rotation(folder):
    """Solid-body rotation before a camera unlike the demo's: square microlenses, M = -0.8, stored as on the chip; the
    truth is not known to the run."""
    camera = PlenopticCamera(
        MainLens(50.0, 22.5, -0.8),
        Lattice("square", 0.077, -0.005, (0.02, -0.03)),
        0.308,
        Sensor(560, 420, 0.0055, 12, 60),
    )
    made = simulate_recording(
        folder / "recording",
        camera,
        flow("rotation", rate_rad_s=60.0),
        dt_s=0.0005,
        volume_mm=((-1.1, 1.1), (-0.8, 0.8), (-2.6, 2.6)),
        windows=((40, 40, 16), (32, 32, 12)),
        orientation="sensor",
        rays=2000,
        seed=11,
    )
    return plenopiv.process(plenopiv.load(made.directory / "experiment.toml")).directory / "report.html"


def recording(folder):
    """One with inner windows as large as the last, volumes beside the field, and a result that was scored."""
    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.003, (0.01, 0.02)),
        0.308,
        Sensor(700, 560, 0.0055, 12, 60),
    )
    made = simulate_recording(
        folder / "recording",
        camera,
        flow("vortex-ring", radius_mm=0.9, core_radius_mm=0.4, circulation_mm2_s=300.0, drift_m_s=(0.0, 0.1, 0.05)),
        dt_s=0.0005,
        volume_mm=((-1.5, 1.5), (-1.1, 1.1), (-2.5, 2.5)),
        windows=((64, 64, 24), (48, 48, 16)),
        rays=2000,
        seed=12,
    )
    experiment = Experiment.load(made.directory / "experiment.toml")
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["correlation"]["inner_window"] = tables["correlation"]["windows"][-1]
    tables["output"]["volumes"] = True
    changed = Experiment.from_dict(tables, experiment.path)
    scored = plenopiv.process(changed, score=lambda velocity: {"largest u (m/s)": float(velocity.u.max())})
    return scored.directory / "report.html"


def series(folder):
    """Five times of a vortex that grows and drifts, on a grid of unequal spacing, with a constant v, a pair set aside,
    replaced and unmeasured vectors: fields without images, beside them the velocity.nc that they were read from."""
    rng, (nz, ny, nx) = np.random.default_rng(5), (7, 6, 9)
    x, y, z = np.linspace(-2.0, 2.2, nx), np.linspace(-1.0, 1.1, ny), np.linspace(-1.5, 1.4, nz)
    at_z, _, at_x = np.meshgrid(z, y, x, indexing="ij")
    near, dims = np.exp(-(at_x**2 + at_z**2)), ("time", "z", "y", "x")
    grown = np.arange(1.0, 6.0)[:, None, None, None]
    values = {"u": grown * at_z * near, "v": np.full((5, nz, ny, nx), 0.31), "w": 0.1 * grown - grown * at_x * near}
    values["u"], values["w"] = (values[n] + rng.normal(0, 0.01, values["u"].shape) for n in "uw")
    for field in values.values():
        field[1] = np.nan  # set aside
        field[:, 0, 0, 0] = np.nan
    values |= {f"{name}_std": rng.gamma(4.0, 0.002, (5, nz, ny, nx)) for name in "uvw"}
    values |= {"peak_ratio": 1 + rng.gamma(3.0, 1.0, (5, nz, ny, nx))}
    values |= {f"{name}_raw": values[name] for name in "uvw"}
    valid = (rng.random((5, nz, ny, nx)) > 0.1) & np.isfinite(values["u"])
    dataset = xr.Dataset(
        {name: (dims, array) for name, array in values.items()} | {"valid": (dims, valid.astype(np.int8))},
        {"time": 0.02 * np.arange(5), "z": z, "y": y, "x": x},
    )
    write_velocity(folder / "velocity.nc", dataset)
    shown, over_time = dataset.isel(time=[0]), {name: np.ones(5) for name in OVER_TIME}
    write_report(
        folder / "report.html", title="five times", experiment=Experiment.from_dict(tomllib.loads(SERIES)), summary={},
        dataset=shown, series=over_time | {"time_s": dataset.time.values},
        fields=series_of_file(folder / "velocity.nc"), date="2026-01-02 03:04 UTC",
    )  # fmt: skip
    return folder / "report.html"


def named(folder):
    """The one that PLENOPIV_REPORT names."""
    return Path(os.environ["PLENOPIV_REPORT"]).resolve()


MAKERS = {"named": named} if "PLENOPIV_REPORT" in os.environ else {f.__name__: f for f in (demo, rotation, recording)}
ALSO = {} if "PLENOPIV_REPORT" in os.environ else {"series": series}
