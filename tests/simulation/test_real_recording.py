"""A recording of a real camera as a folder: all that its experiment file names, and the same by the command line."""

import json
import tomllib

import numpy as np
import pytest
import tifffile

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import Uniform
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_recording import Extras, TargetPlanes, data_sheet, simulate_real_recording
from plenopiv.simulation.simulated_recording import Seeding
from plenopiv.simulation.targets import DotTarget

SHEET = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077, 0.005), 0.308, Sensor(120, 96, 0.0055, 12, 60)
)
WATER = Medium(1.333, 40.0, 10.0, 1.52, (1.0, 0.0))
CAMERA = RealCamera.of(SHEET, stop_mm=10.0, medium=WATER, pose=Pose(1.0, (0.02, 0.01, 0.3)))
VOLUME = ((-0.2, 0.2), (-0.15, 0.15), (-1.0, 1.0))
FLOW = Uniform((0.02, 0.0, 0.01))
WINDOWS = ((16, 16, 16),)
PLANES = TargetPlanes(DotTarget(0.25, 0.1, 0.16, 0.13, step_mm=0.2), (-0.5, 0.0, 0.5), samples=16)


def made(folder, **more):
    settings = {"dt_s": 1e-3, "volume_mm": VOLUME, "windows": WINDOWS, "rays": 500, "seed": 4}
    return simulate_real_recording(folder, CAMERA, FLOW, **settings | more)


def test_a_tank(tmp_path):
    static = tuple(np.full((96, 120), light) for light in (80.0, 60.0))
    extras = Extras(PLANES, second_pulse=0.5, static_light=static, dark=True)
    recording = made(tmp_path / "tank", pairs=2, extras=extras)
    experiment = Experiment.load(tmp_path / "tank" / "experiment.toml")
    images = experiment.recording()
    assert len(images.pairs) == 2
    assert experiment.camera() == SHEET.with_lattice(Lattice("hexagonal", 0.077))
    assert experiment.medium.window_tilt_deg == (1.0, 0.0)
    assert [plane.z_mm for plane in experiment.calibration.planes] == [-0.5, 0.0, 0.5]
    assert experiment.calibration.origin_dot_mm == 0.16
    assert experiment.calibration.step_mm == 0.2
    for plane in experiment.calibration.planes:
        assert tifffile.imread(tmp_path / "tank" / plane.image).max() > 500
    dark = tifffile.imread(tmp_path / "tank" / "dark.tif")
    assert dark.mean() == pytest.approx(60, abs=0.3)
    assert dark.std() < 1.0
    static_counts = [tifffile.imread(tmp_path / "tank" / f"background_{n}.tif").mean() - 60 for n in "ab"]
    assert static_counts == pytest.approx([0.5 * 84, 0.5 * 64], rel=0.02)
    light = [recording.images[f"run_0002_{n}"].mean() - 60 - s for n, s in zip("ab", static_counts, strict=True)]
    assert light[1] == pytest.approx(0.5 * light[0], rel=0.15)
    truth = json.loads((tmp_path / "tank" / "truth.json").read_text())
    assert truth["camera"]["stop_mm"] == 10.0
    assert truth["exit_pupil_to_microlenses_mm"] == pytest.approx(112.5)
    with np.load(tmp_path / "tank" / "truth_particles_0002.npz") as particles:
        moved = particles["b"] - particles["a"]
        assert moved == pytest.approx(np.broadcast_to([0.02, 0.0, 0.01], moved.shape), abs=1e-6)
        assert len(moved) == truth["particles"][1] == len(recording.pairs[1][0].electrons)


def test_one_pair_follows_from_its_seed(tmp_path):
    one, two, other = (made(tmp_path / str(k), seed=seed) for k, seed in enumerate((4, 4, 5)))
    assert set(one.images) == {"white", "a", "b"}
    assert all((one.images[name] == two.images[name]).all() for name in one.images)
    assert (one.images["a"] != other.images["a"]).any()
    experiment = Experiment.load(tmp_path / "0" / "experiment.toml")
    assert experiment.calibration is None
    assert experiment.volume.voxel_mm[2] == pytest.approx(0.077 * 1.333)
    with pytest.raises(PlenoPIVError, match="holds a recording already"):
        made(tmp_path / "0")


def test_a_data_sheet_may_be_wrong(tmp_path):
    wrong = PlenopticCamera(MainLens(51.0, 24.0, -0.98), SHEET.lattice, 0.31, SHEET.sensor)
    made(tmp_path / "made", sheet=wrong, medium_known=False)
    experiment = Experiment.load(tmp_path / "made" / "experiment.toml")
    assert experiment.camera().main_lens == wrong.main_lens
    assert experiment.medium is None
    assert data_sheet(CAMERA) == SHEET


def test_particles_beyond_the_window(tmp_path):
    with pytest.raises(PlenoPIVError, match="not in front of the window"):
        made(tmp_path / "made", volume_mm=(*VOLUME[:2], (38.0, 40.5)), seeding=Seeding())
    assert not (tmp_path / "made" / "experiment.toml").exists()


FILE = """
[simulation]
flow = "uniform"
parameters = {{ velocity_m_s = [0.02, 0.0, 0.0] }}
rays = 200
dark = true
optics = {{ stop_mm = {stop}, rim_radius_mm = 13.0, distortion = 0.01, gap_tilt = 0.01, aspect = 0.001 }}
pose = {{ turn_deg = 1.0, origin_mm = [0.02, 0.01, 0.3] }}
target = {{ electrons_per_pixel = 2000.0, missing = [[-1, 0]], cut = [{{ column = 1, row = 1 }}] }}
"""


def test_on_the_command_line(tmp_path, capsys):
    made(tmp_path / "first", extras=Extras(PLANES))
    file = tmp_path / "first" / "experiment.toml"
    text = file.read_text()
    file.write_text(text + FILE.format(stop=12.0))
    assert main(["simulate", str(file), str(tmp_path / "second")]) == 0
    written = tomllib.loads((tmp_path / "second" / "experiment.toml").read_text())
    asked = tomllib.loads(text)
    assert written["medium"] == asked["medium"]
    assert written["calibration"] == asked["calibration"]
    truth = json.loads((tmp_path / "second" / "truth.json").read_text())["camera"]
    assert truth["stop_mm"] == 12.0
    assert truth["pose"]["turn_deg"] == 1.0
    names = {"white.tif", "dark.tif", "a.tif", "b.tif", "target_00.tif", "target_02.tif", "truth_particles.npz"}
    assert names <= {path.name for path in (tmp_path / "second").iterdir()}
    capsys.readouterr()
    file.write_text(text + FILE.format(stop=80.0))
    assert main(["simulate", str(file), str(tmp_path / "third")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "leave no air in front of the stop" in said
    assert not (tmp_path / "third").exists()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("z0/target.tif", "z1/target.tif"), "'z0/target.tif' cannot be the file of a target; give NAME.tif"),
        (("t0.png", "t1.png"), "'t0.png' cannot be"),
        (("t0.tif", "white.tif"), "'white.tif' cannot be .* none of white, a, b"),
        (("t0.tif", "t0.tif"), "t0.tif, t0.tif name one file for two targets"),
    ],
)
def test_files_of_targets_that_cannot_be_written_so_are_refused(names, said):
    """Folder and suffix were left away: two images became one file, which the experiment file named otherwise."""
    with pytest.raises(PlenoPIVError, match=said):
        TargetPlanes(PLANES.target, (-0.5, 0.5), names=names)
    assert TargetPlanes(PLANES.target, (-0.5, 0.5), names=("near.tif", "far.tif")).files() == ("near.tif", "far.tif")
