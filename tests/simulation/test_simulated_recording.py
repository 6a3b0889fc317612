"""A whole recording of a tiny camera, written, read back and compared with the one that came from elsewhere."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tifffile
import xarray as xr
from oracles.light import point_image_quadrature
from oracles.scorer import naive_score

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import Rotation, flow
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding, WhiteLight, as_json, seed_pair, simulate_recording

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.002, (0.03, 0.02)),
    0.308,
    Sensor(300, 240, 0.0055, 12, 60),
)
VOLUME = ((-0.6, 0.6), (-0.45, 0.45), (-1.0, 1.0))
FLOW = flow("rotation", drift_m_s=(0.0, 0.1, 0.0))


def write(folder, **options):
    return simulate_recording(
        folder, CAMERA, FLOW, **({"dt_s": 5e-4, "volume_mm": VOLUME, "rays": 2000, "seed": 3} | options)
    )


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return write(tmp_path_factory.mktemp("recording") / "r")


def test_numbers_and_arrays_of_numpy_are_recorded_as_others(tmp_path, recorded):
    """Files are written last: one that cannot be written would lose all that was simulated."""
    turned = flow("rotation", rate_rad_s=np.float32(80), drift_m_s=np.array([0.0, 0.1, 0.0]))
    moved = Rotation(np.float32(80), drift_m_s=np.array([0.0, 0.1, 0.0]))
    for name, given in (("by name", turned), ("as it is", moved)):
        written = simulate_recording(
            tmp_path / name,
            CAMERA,
            given,
            dt_s=np.float64(5e-4),
            volume_mm=np.array(VOLUME),
            rays=2000,
            seed=np.int64(3),
        )
        for file in ("truth.json", "optics.json"):
            now, before = (json.loads((each.directory / file).read_text()) for each in (written, recorded))
            assert now == before
        assert np.array_equal(written.images["b"], recorded.images["b"])
    assert json.loads(as_json({"path": Path("flow.nc"), "n": np.int64(3)})) == {"path": "flow.nc", "n": 3}


def test_files_and_pixels(recorded):
    names = {p.name for p in recorded.directory.iterdir()}
    assert names == {
        "white.tif", "a.tif", "b.tif", "optics.json", "experiment.toml", "truth.json", "truth_particles.npz",
    }  # fmt: skip
    for name in ("white", "a", "b"):
        image = tifffile.imread(recorded.directory / f"{name}.tif")
        assert image.shape == (240, 300)
        assert image.dtype == np.uint16
        assert np.array_equal(image, recorded.images[name])
    assert recorded.images["white"].max() <= 4095
    assert recorded.images["a"].mean() > 100


def test_experiment_file_says_what_was_simulated(recorded):
    e = tomllib.loads((recorded.directory / "experiment.toml").read_text())
    assert e["camera"]["main_lens"] == {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0}
    assert e["camera"]["microlens_array"] == {"lattice": "hexagonal", "pitch_mm": 0.077, "focal_length_mm": 0.308}
    assert e["camera"]["sensor"] == {
        "columns": 300, "rows": 240, "pixel_pitch_mm": 0.0055, "bit_depth": 12, "black_level": 60,
    }  # fmt: skip
    assert e["recording"]["frames"] == ["a.tif", "b.tif"]
    assert e["recording"]["dt_s"] == 5e-4
    assert [e["volume"][f"{k}_mm"] for k in "xyz"] == [list(map(float, v)) for v in VOLUME]
    assert e["volume"]["voxel_mm"] == [0.017142857143, 0.017142857143, 0.077]


def test_truth_holds_the_displacements_of_the_flow(recorded):
    with np.load(recorded.directory / "truth_particles.npz") as truth:
        a, b = truth["a"], truth["b"]
    assert a.dtype == np.float32
    assert a.shape == b.shape == (json.loads((recorded.directory / "truth.json").read_text())["particles"], 3)
    middle = (a + b) / 2.0
    expected = np.stack([0.04 * middle[:, 2], np.full(len(a), 0.05), -0.04 * middle[:, 0]], -1)
    assert b - a == pytest.approx(expected, abs=1e-5)


def test_frames_show_the_particles_of_the_truth(recorded):
    for name, particles in (("a", recorded.a), ("b", recorded.b)):
        counts = recorded.images[name] - 60.0
        expected = particle_image(CAMERA, particles, rays=20_000, diffraction_nm=532.0) + 4.0
        assert counts.mean() == pytest.approx(0.5 * expected.mean(), rel=0.01)
        assert np.corrcoef(counts.ravel(), expected.ravel())[0, 1] > 0.98


def test_the_seed_fixes_everything_and_sensor_images_are_turned(recorded, tmp_path):
    again = write(tmp_path / "again")
    turned = write(tmp_path / "turned", orientation="sensor")
    other = write(tmp_path / "other", seed=4)
    for name in ("white", "a", "b"):
        assert np.array_equal(again.images[name], recorded.images[name])
        assert np.array_equal(turned.images[name], np.rot90(recorded.images[name], 2))
        assert not np.array_equal(other.images[name], recorded.images[name])
    assert 'orientation = "sensor"' in (turned.directory / "experiment.toml").read_text()


def test_an_unknown_orientation_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(PlenoPIVError, match=r"recording.orientation: 'up' is no orientation"):
        write(tmp_path / "r", orientation="up")
    assert not (tmp_path / "r").exists()


def test_a_recording_is_not_overwritten_unless_asked(recorded, tmp_path):
    before = (recorded.directory / "a.tif").stat().st_mtime_ns
    with pytest.raises(PlenoPIVError, match="--overwrite"):
        write(recorded.directory)
    assert (recorded.directory / "a.tif").stat().st_mtime_ns == before
    (tmp_path / "experiment.toml").write_text("old")
    write(tmp_path, overwrite=True)
    assert "[camera]" in (tmp_path / "experiment.toml").read_text()
    assert not list(tmp_path.glob(".*.part"))


@pytest.mark.parametrize("name", ["white.tif", "b.tif", "optics.json", "truth_particles.npz"])
def test_images_of_a_camera_are_not_lost(tmp_path, name):
    """A folder of raw images, before an experiment file is drafted."""
    (tmp_path / name).write_text("raw")
    with pytest.raises(PlenoPIVError, match=f"{name}: is there; choose another folder"):
        write(tmp_path)
    assert (tmp_path / name).read_text() == "raw"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_that_cannot_be_is_told_before_rays_are_traced(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(PlenoPIVError, match=f"cannot be made, {tmp_path / 'file'} is no folder"):
            write(folder, progress=lambda *_: pytest.fail("rays were traced"))


def test_particles_enter_and_leave_the_volume():
    rng = np.random.default_rng(0)
    a, b = seed_pair(CAMERA, flow("uniform", velocity_m_s=(0.4, 0, 0)), 5e-4, VOLUME, Seeding(), rng)
    inside_a, inside_b = (np.abs(p.position_mm[:, 0]) <= 0.6 for p in (a, b))
    assert (inside_a & ~inside_b).sum() > 10
    assert (inside_b & ~inside_a).sum() > 10
    # both frames are full to the volume's faces
    for p in (a, b):
        assert p.position_mm[:, 0].min() < -0.58
        assert p.position_mm[:, 0].max() > 0.58


def test_given_particles_and_noise_are_used(tmp_path):
    one = Particles(np.array([[0.1, 0.05, 0.5]]), np.array([5e4]))
    still = SensorNoise(gain=1.0, read_noise_electrons=0.0, shot=False)
    r = write(
        tmp_path,
        particles=(one, one),
        noise=still,
        seeding=Seeding(background_electrons=0.0),
        white=WhiteLight(1000.0),
        diffraction=False,
    )
    assert r.images["white"].max() == 1060
    assert (r.images["a"] - 60.0).sum() == pytest.approx(5e4, rel=0.01)


def test_progress_covers_both_frames(tmp_path):
    calls = []
    r = write(tmp_path, progress=lambda done, total: calls.append((done, total)))
    total = 2 * len(r.a.electrons)
    assert calls[-1] == (total, total)
    assert [c[0] for c in calls] == sorted(c[0] for c in calls)


def keys(tree):
    return {k: keys(v) if isinstance(v, dict) else None for k, v in tree.items()}


def test_layout_is_that_of_the_rotation_recording(recorded):
    """Tables and keys as recordings made elsewhere have them, in their order; ours may tell more of the truth."""
    lens = {"focal_length_mm": None, "aperture_mm": None, "magnification": None}
    sensor = {"columns": None, "rows": None, "pixel_pitch_mm": None}
    optics = json.loads((recorded.directory / "optics.json").read_text())
    assert list(optics) == ["main_lens", "microlens_array", "sensor", "recording", "seeding"]
    assert keys(optics) == {
        "main_lens": lens | {"object_distance_mm": None, "image_distance_mm": None},
        "microlens_array": {"lattice": None, "pitch_mm": None, "focal_length_mm": None},
        "sensor": sensor | {"bits": None, "black_level": None},
        "recording": {"orientation": None, "dt_s": None, "wavelength_nm": None},
        "seeding": {"particles_per_microlens": None, "depth_mm": None},
    }
    experiment = tomllib.loads((recorded.directory / "experiment.toml").read_text())
    assert list(experiment) == ["camera", "recording", "volume", "reconstruction", "correlation", "output"]
    assert keys(experiment) == {
        "camera": {
            "kind": None,
            "main_lens": lens,
            "microlens_array": {"lattice": None, "pitch_mm": None, "focal_length_mm": None},
            "sensor": sensor | {"bit_depth": None, "black_level": None},
        },
        "recording": {"white": None, "frames": None, "dt_s": None, "orientation": None},
        "volume": {"x_mm": None, "y_mm": None, "z_mm": None, "voxel_mm": None},
        "reconstruction": {"method": None, "iterations": None, "relaxation": None},
        "correlation": {"windows": None, "overlap": None},
        "output": {"directory": None},
    }
    truth = json.loads((recorded.directory / "truth.json").read_text())
    assert {"flow", "seed", "lattice_rotation_deg", "lattice_offset_mm", "particles"} <= set(truth)
    with np.load(recorded.directory / "truth_particles.npz") as p:
        assert set(p) == {"a", "b"}
        assert p["a"].dtype == np.float32


def test_another_tracer_s_image_is_reproduced(tmp_path):
    """A whole frame against the light of each of its particles by quadrature over the aperture, plus the stray light:
    brightness by brightness within 2 %, and without noise pixel by pixel within what either traces roughly."""
    still = SensorNoise(gain=0.5, read_noise_electrons=0.0, shot=False)
    seeding = Seeding(particles_per_microlens=0.2)
    made = write(tmp_path / "r", noise=still, seeding=seeding, diffraction=False, rays=10_000)
    expected = np.full((240, 300), 4.0)
    for place, electrons in zip(made.a.position_mm, made.a.electrons, strict=True):
        expected += electrons * point_image_quadrature(CAMERA, place, 300)
    expected *= 0.5
    counts = made.images["a"] - 60.0
    assert np.corrcoef(counts.ravel(), expected.ravel())[0, 1] > 0.999
    for lo, hi in ((10, 50), (50, 100), (100, 200), (200, 400)):
        in_class = (expected > lo) & (expected <= hi)
        assert in_class.sum() > 50
        assert (counts - expected)[in_class].mean() == pytest.approx(0.0, abs=0.02 * hi)


def test_the_flow_itself_scores_without_error(recorded):
    """Signs, units and mid-time positions: the exact velocity at every vector against the particles written."""
    z, y, x = np.meshgrid(
        np.linspace(-0.6, 0.6, 5), np.linspace(-0.2, 0.2, 3), np.linspace(-0.3, 0.3, 5), indexing="ij"
    )
    velocity = FLOW(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
    axes = {"time": [0.0], "z": z[:, 0, 0], "y": y[0, :, 0], "x": x[0, 0, :]}
    dims = ("time", "z", "y", "x")
    fields = {f"{name}{more}": (dims, velocity[None, ..., k]) for k, name in enumerate("uvw") for more in ("", "_raw")}
    fields |= {f"{name}_std": (dims, np.ones((1, *x.shape))) for name in "uvw"}
    fields["valid"] = dims, np.ones((1, *x.shape), np.int8)
    with np.load(recorded.directory / "truth_particles.npz") as p:
        a, b = p["a"], p["b"]
    settings = {"dt_s": 5e-4, "voxel_mm": (36 / 2100, 36 / 2100, 0.077), "window_voxels": (32, 32, 8)}
    score = naive_score(xr.Dataset(fields, axes), a, b, CAMERA, **settings)
    assert score["vectors"] > 20
    assert score["final"]["gross"] == 0
    assert score["final"]["rms"].max() < 2e-3
    true = np.sqrt(np.mean(np.square((b - a) / settings["voxel_mm"]), axis=0))
    assert true.min() > 0.1
