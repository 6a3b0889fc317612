"""plenopiv track on a small simulated recording of a uniform flow."""

import json

import numpy as np
import pytest
import tomli_w
import xarray
from particle_scenes import nearest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.run.track import track
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

pytestmark = pytest.mark.full  # a recording is simulated, reconstructed, tracked and linked
VELOCITY_M_S = np.array([0.11, -0.06, 0.17])  # 3.2, -1.8 and 1.1 voxels in 0.5 ms: another size and sign on each axis
DT_S = 5e-4
CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
    0.308,
    Sensor(320, 320, 0.0055, 12, 60),
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The folder of a recording that was tracked, and its tracks."""
    folder = tmp_path_factory.mktemp("tracked") / "recording"
    simulate_recording(
        folder,
        CAMERA,
        flow("uniform", velocity_m_s=tuple(VELOCITY_M_S)),
        dt_s=DT_S,
        volume_mm=((-0.6, 0.6), (-0.6, 0.6), (-1.6, 1.6)),
        windows=((48, 48, 20), (32, 32, 16)),
        seeding=Seeding(0.4),
        rays=4000,
        seed=3,
    )
    assert main(["--quiet", "track", str(folder / "experiment.toml")]) == 0
    return folder, xarray.load_dataset(folder / "results" / "tracks.nc")


def test_particles_and_links_are_true(recording):
    folder, tracks = recording
    with np.load(folder / "truth_particles.npz") as truth:
        a, b = truth["a"].astype(float), truth["b"].astype(float)
    beyond = np.abs(a[:, 2]) > 0.5
    found = np.stack([tracks[name].values for name in "xyz"], -1)
    first, second = np.flatnonzero(tracks.frame == 0), np.flatnonzero(tracks.frame == 1)
    of_a, of_b = nearest(a, found[first]), nearest(b, found[second])
    both = beyond & (of_a >= 0) & (of_b >= 0)
    assert both.sum() > 0.9 * beyond.sum()
    ids = tracks.track_id.values
    id_a, id_b = ids[first[of_a[both]]], ids[second[of_b[both]]]
    assert ((id_a == id_b) & (id_a >= 0)).mean() > 0.95
    assert ((id_a != id_b) & (id_a >= 0) & (id_b >= 0)).sum() == 0
    linked = first[of_a[both]][id_a >= 0]
    velocity = np.stack([tracks[name].values for name in "uvw"], -1)[linked]
    assert np.median(velocity, 0) == pytest.approx(VELOCITY_M_S, abs=2e-3)
    std = np.stack([tracks[f"{name}_std"].values for name in "uvw"], -1)[linked]
    assert 0.5 < (np.abs(velocity - VELOCITY_M_S) < std).mean() < 0.85


def test_names_and_units_of_the_file(recording):
    _, tracks = recording
    assert set(tracks.sizes) == {"obs", "parameter", "parameter_2"}
    assert [tracks[name].attrs["units"] for name in ("x", "x_std", "u", "u_std")] == ["mm", "mm", "m s-1", "m s-1"]
    assert tracks.covariance.dims == ("obs", "parameter", "parameter_2")
    both = tracks.isel(obs=np.flatnonzero(tracks.track_id >= 0))
    assert np.unique(both.track_id, return_counts=True)[1].tolist() == [2] * (both.sizes["obs"] // 2)
    matrix = both.covariance.values
    assert np.sqrt(matrix[:, 2, 2]) == pytest.approx(both.z_std.values)
    assert np.sqrt(matrix[:, 5, 5]) == pytest.approx(both.w_std.values)
    assert matrix == pytest.approx(np.swapaxes(matrix, 1, 2))
    later = both.isel(obs=np.flatnonzero(both.frame == 1)).covariance.values
    assert (later[:, 0, 3] > 0).all()  # what puts the second position too far makes the velocity too large
    alone = tracks.isel(obs=np.flatnonzero(tracks.track_id < 0))
    assert np.isnan(alone.u).all()
    assert np.isfinite(alone.x).all()


def test_tracks_are_not_replaced_unasked(recording, capsys):
    folder, _ = recording
    assert main(["track", str(folder / "experiment.toml")]) == 2
    assert "tracks.nc: is already there; use --overwrite" in capsys.readouterr().err


def test_other_frames_of_reference_are_refused(recording, tmp_path):
    folder, _ = recording
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["medium"] = {"refractive_index": 1.33, "fluid_mm": 30.0}
    tables["output"]["directory"] = str(tmp_path / "other")
    (folder / "water.toml").write_text(tomli_w.dumps(json.loads(json.dumps(tables))))
    with pytest.raises(PlenoPIVError, match=r"cannot yet take \[calibration\] or \[medium\]"):
        track(Experiment.load(folder / "water.toml"))
