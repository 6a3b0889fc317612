"""simulate, calibrate and info on good input."""

import numpy as np
import pytest
from drafted_recording import edit

from plenopiv.cli import main
from plenopiv.displacement.windows import step_of
from plenopiv.experiment import Experiment

SIMULATION = """
[simulation]
flow = "uniform"
parameters = { velocity_m_s = [0.1, 0.0, 0.0] }
particles_per_microlens = 0.1
rays = 200
"""


def test_simulate_then_calibrate_and_inform(folder, tmp_path, capsys, one_line):
    file = folder / "experiment.toml"
    assert "has no [simulation] table" in one_line("simulate", file, tmp_path / "synthetic")
    file.write_text(file.read_text() + SIMULATION)
    edit(folder, "pitch_mm = 0.077 ", "rotation_deg = 0.4\noffset_mm = [0.01, 0.02]\npitch_mm = 0.077 ")
    assert "holds the experiment file itself" in one_line("simulate", file, folder)
    assert main(["simulate", str(file), str(tmp_path / "synthetic")]) == 0
    assert "holds a recording already" in one_line("simulate", file, tmp_path / "synthetic")
    capsys.readouterr()

    made = tmp_path / "synthetic" / "experiment.toml"
    assert Experiment.load(made).volume == Experiment.load(file).volume
    assert main(["calibrate", str(made)]) == 0
    assert "rotation   +0.4" in capsys.readouterr().out
    assert "is already there" in one_line("calibrate", made)
    assert main(["calibrate", str(made), "--overwrite"]) == 0

    capsys.readouterr()
    assert main(["info", str(made)]) == 0
    text = capsys.readouterr().out
    for part in (
        "14.00 pixels per microlens",
        "f/4",
        "z from -0.309 to 0.307 mm",
        "million voxels",
        "seen by every view",
    ):
        assert part in text
    assert main(["info", str(tmp_path / "synthetic" / "a.tif")]) == 0
    assert "280 x 224 px" in capsys.readouterr().out


def test_a_rehearsal_is_measured_as_the_file_says(folder, tmp_path, capsys):
    file = folder / "experiment.toml"
    text = file.read_text().replace('directory = "results"', 'directory = "/data"\nvolumes = true')
    text = text.replace("overlap = 0.5", "overlap = 0.75\nsmoothing_voxels = [1.5, 1.5, 1.0]").replace(
        "iterations = 5", "iterations = 7"
    )
    file.write_text(text + SIMULATION + "[tracking]\ngrid_mm = 0.3\n")
    asked = Experiment.load(file)
    assert main(["simulate", str(file), str(tmp_path / "synthetic")]) == 0
    made = Experiment.load(tmp_path / "synthetic" / "experiment.toml")
    assert (made.reconstruction, made.correlation, made.tracking) == (
        asked.reconstruction,
        asked.correlation,
        asked.tracking,
    )
    assert (made.output.directory, made.output.volumes) == ("results", True)
    assert (made.correlation.overlap, made.reconstruction.iterations) == (0.75, 7)
    assert "not simulated" not in capsys.readouterr().err
    file.write_text(text.replace("[volume]", '[volume]\nbody = "hull.stl"') + SIMULATION)
    assert main(["simulate", str(file), str(tmp_path / "with-body")]) == 0
    assert "volume.body: not simulated, and left out of the recording" in capsys.readouterr().err


def test_a_place_of_no_target_is_refused(folder, tmp_path, one_line):
    file = folder / "experiment.toml"
    file.write_text(file.read_text() + SIMULATION + "pose = { turn_deg = 1.0 }\n")
    assert "simulation.pose: places a target, and there is none; add" in one_line("simulate", file, tmp_path / "made")


@pytest.mark.parametrize(
    ("flow", "parameters", "said"),
    [
        ("lamb-oseen", "core_radius_mm = 1e-200", "core_radius_mm = 1e-200; give a length above 0"),
        ("vortex-ring", "radius_mm = 1e200", "radius_mm = 1e+200; give a number up to 1e+09"),
        ("vortex-ring", "circulation_mm2_s = 1e300", "give a number up to 1e+09"),
        ("vortex-ring", "circulation_mm2_s = 1e9", "are too many"),
        ("file", "speed = 1.0", "simulation.flow: 'file' needs the parameter 'path'"),
    ],
)
def test_parameters_beyond_all_flows_are_one_line(folder, tmp_path, one_line, flow, parameters, said):
    file = folder / "experiment.toml"
    own = SIMULATION.replace("uniform", flow).replace("velocity_m_s = [0.1, 0.0, 0.0]", parameters)
    file.write_text(file.read_text() + own)
    assert said in one_line("simulate", file, tmp_path / "made")


def test_a_wrong_flow_is_named(folder, tmp_path, one_line):
    file = folder / "experiment.toml"
    file.write_text(file.read_text() + SIMULATION.replace("uniform", "unifrom"))
    assert "simulation.flow: no flow is called 'unifrom', did you mean 'uniform'?" in one_line(
        "simulate", file, tmp_path / "synthetic"
    )
    assert not (tmp_path / "synthetic").exists()


def test_info_of_a_velocity_file_and_of_others(tmp_path, capsys, one_line):
    import xarray as xr

    from plenopiv.io import write_velocity

    dims, shape = ("time", "z", "y", "x"), (1, 2, 3, 4)
    values = {name: (dims, np.full(shape, value)) for name, value in zip("uvw", (0.1, -0.2, 0.0), strict=True)}
    values["valid"] = (dims, (np.arange(24).reshape(shape) < 18).astype(np.int8))
    axes = {"time": [0.0], "z": np.arange(2.0), "y": np.arange(3.0), "x": np.arange(4.0)}
    write_velocity(tmp_path / "velocity.nc", xr.Dataset(values, axes))
    assert main(["info", str(tmp_path / "velocity.nc")]) == 0
    text = capsys.readouterr().out
    assert "4 x 3 x 2" in text
    assert "75.0 % measured" in text
    assert "mean -0.2" in text
    assert "missing" not in text
    (tmp_path / "notes.txt").write_text("a note")
    assert "is no image file that is known; TIFF, PNG" in one_line("info", tmp_path / "notes.txt")
    assert "no such file" in one_line("info", tmp_path / "none.nc")
    assert "is a folder; name the experiment file, velocity.nc or the image in it" in one_line("info", tmp_path)


def test_info_rounds_the_spacing_of_vectors_as_a_run_does(folder, capsys):
    file = edit(folder, "overlap = 0.5", "overlap = 0.7")
    capsys.readouterr()
    assert main(["info", str(file)]) == 0
    table = Experiment.load(file)
    steps = [step_of(n, 0.7) for n in table.correlation.windows[-1]]
    assert steps != [0.3 * n for n in table.correlation.windows[-1]]
    spacing = " x ".join(f"{1e3 * d * n:.3g}" for d, n in zip(table.volume.voxel_mm, steps, strict=True))
    assert f"every {spacing} um" in capsys.readouterr().out


def test_info_counts_what_is_not_there_as_not_measured(tmp_path, capsys):
    """Of two pairs one was set aside, and of the other's vectors a quarter was replaced."""
    import xarray as xr

    from plenopiv.io import write_velocity

    dims, shape = ("time", "z", "y", "x"), (2, 2, 3, 4)
    valid = (np.arange(48).reshape(shape) < 18).astype(np.int8)
    speed = np.ones(shape)
    speed[1] = np.nan
    axes = {"time": [0.0, 1.0], "z": np.arange(2.0), "y": np.arange(3.0), "x": np.arange(4.0)}
    values = dict.fromkeys("uvw", (dims, speed)) | {"valid": (dims, valid)}
    write_velocity(tmp_path / "velocity.nc", xr.Dataset(values, axes))
    assert main(["info", str(tmp_path / "velocity.nc")]) == 0
    text = capsys.readouterr().out
    assert "37.5 % measured, the rest replaced or missing" in text
    assert "24, of pairs that were set aside or inside the body" in text


@pytest.mark.full
def test_simulate_a_jet_and_a_field_from_a_file(folder, tmp_path, one_line):
    """The camera looks at the jet's shear layer; the file lies beside the experiment file."""
    import json

    import xarray as xr

    from plenopiv.simulation.flows import flow

    def truth(name):
        with np.load(tmp_path / name / "truth_particles.npz") as particles:
            a, b = particles["a"], particles["b"]
        return 0.5 * (a + b), (b - a) * 1e-3 / 0.0005, json.loads((tmp_path / name / "truth.json").read_text())

    file = folder / "experiment.toml"
    plain = file.read_text()
    jet = SIMULATION.replace('"uniform"', '"jet"').replace("velocity_m_s = [0.1, 0.0, 0.0]", "at_mm = [2.0, 3.0, 0.0]")
    file.write_text(plain + jet)
    assert main(["simulate", str(file), str(tmp_path / "jet")]) == 0
    middle, velocity_m_s, told = truth("jet")
    np.testing.assert_allclose(velocity_m_s, flow("jet", at_mm=(2.0, 3.0, 0.0))(middle), atol=5e-3)
    assert np.ptp(velocity_m_s[:, 0]) > 0.1
    assert told["flow"] == "jet"
    assert told["flow_parameters"] == {"at_mm": [2.0, 3.0, 0.0], "speed": 1.0}

    axis = np.linspace(-3.0, 3.0, 9)
    z = np.broadcast_to(axis[:, None, None], (9, 9, 9))
    rates = zip("uvw", (40.0, 0.0, 0.0), strict=True)
    values = {name: (("z", "y", "x"), rate * z, {"units": "mm/s"}) for name, rate in rates}
    axes = {name: (name, axis, {"units": "mm"}) for name in "xyz"}
    xr.Dataset(values, axes).to_netcdf(folder / "shear.nc", engine="h5netcdf")
    own = SIMULATION.replace('"uniform"', '"file"').replace("velocity_m_s = [0.1, 0.0, 0.0]", 'path = "shear.nc"')
    file.write_text(plain + own)
    assert main(["simulate", str(file), str(tmp_path / "file")]) == 0
    middle, velocity_m_s, _ = truth("file")
    np.testing.assert_allclose(velocity_m_s[:, 0], 0.04 * middle[:, 2], atol=1e-5)

    file.write_text(plain + own.replace("shear.nc", "none.nc"))
    assert f"simulation.flow: {folder / 'none.nc'}: no such file" in one_line("simulate", file, tmp_path / "no")
    file.write_text(plain + own.replace('path = "shear.nc"', 'path = "shear.nc", at_mm = [2.5, 0.0, 0.0]'))
    message = one_line("simulate", file, tmp_path / "no")
    assert "shear.nc: asked for x = " in message
    assert 'set outside = "zero" or "periodic"' in message
