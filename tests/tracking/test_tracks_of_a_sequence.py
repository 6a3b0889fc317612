"""plenopiv track with tracking.method = "multi-frame" on a small simulated sequence of a curved flow."""

import json
import re
import shutil

import numpy as np
import pytest
import tifffile
import tomli_w
import xarray
from experiment_files import with_keys
from particle_scenes import VOXEL_MM, nearest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.run import track_smooth
from plenopiv.run.track import track
from plenopiv.run.track_field import velocity_of_tracks
from plenopiv.run.track_sequence import BEGUN
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.sequence import simulate_sequence
from plenopiv.simulation.simulated_recording import Seeding

pytestmark = pytest.mark.full  # a sequence is simulated, its first frames reconstructed, and tracked
DT_S, FRAMES = 5e-4, 9
FLOW = flow("abc", wavelength_mm=4.0, amplitudes_m_s=(0.06, 0.04, 0.08), drift_m_s=(0.02, -0.03, 0.0))
CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
    0.308,
    Sensor(320, 320, 0.0055, 12, 60),
)


def acceleration(points_mm):
    """(n, 3) m/s^2 along the paths of the steady flow."""
    u, h = FLOW(points_mm), 1e-6
    return (FLOW(points_mm + 1e3 * h * u) - FLOW(points_mm - 1e3 * h * u)) / (2 * h)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """The folder of a sequence that was tracked, the truth (frames, n, 3), and its tracks."""
    folder = tmp_path_factory.mktemp("followed") / "recording"
    made = simulate_sequence(
        folder,
        CAMERA,
        FLOW,
        FRAMES,
        dt_s=DT_S,
        volume_mm=((-0.6, 0.6), (-0.6, 0.6), (-1.6, 1.6)),
        windows=((64, 64, 24), (48, 48, 16)),
        seeding=Seeding(0.8, margin_mm=(0.25, 0.2, 0.2)),
        lit_mm=((-0.6, 0.6), (-0.6, 0.6), (-1.6, 1.6)),
        rays=8000,
        seed=3,
    )
    path = with_keys(folder, "multi.toml", folder / "results", tracking={"method": "multi-frame"})
    assert main(["--quiet", "track", str(path)]) == 0
    return (
        folder,
        np.stack([frame.position_mm for frame in made.frames]),
        xarray.load_dataset(made.directory / "results" / "tracks.nc"),
    )


@pytest.fixture(scope="module")
def partners(sequence):
    """Of each entry of the tracks the true particle, -1 for none."""
    _, truth, tracks = sequence
    found, out = np.stack([tracks[name].values for name in "xyz"], -1), np.full(tracks.sizes["obs"], -1)
    for k in range(FRAMES):
        own = np.flatnonzero(tracks.frame.values == k)
        partner = nearest(truth[k], found[own])
        out[own[partner[partner >= 0]]] = np.flatnonzero(partner >= 0)
    return out


def test_particles_stay_on_one_track(sequence, partners):
    _, truth, tracks = sequence
    inside = (np.abs(truth) < (0.6, 0.6, 1.6)).all((0, 2)) & (np.abs(truth[:, :, 2]) > 0.5).all(0)
    assert inside.sum() > 50
    ids = tracks.track_id.values
    longest = [
        np.unique(ids[(partners == p) & (ids >= 0)], return_counts=True)[1].max(initial=0)
        for p in np.flatnonzero(inside)
    ]
    assert np.mean(np.array(longest) == FRAMES) > 0.9
    mixed = [len(set(partners[(ids == one) & (partners >= 0)])) for one in np.unique(ids[ids >= 0])]
    assert np.mean(np.array(mixed) > 1) < 0.06  # two within a voxel, seen as one


def test_velocities_and_accelerations_are_true(sequence, partners):
    """On every axis: accelerations follow the true ones with slope one, and lie within their bars."""
    _, truth, tracks = sequence
    at = truth[tracks.frame.values, np.maximum(partners, 0)]
    value = {name: tracks[name].values for name in ("u", "v", "w", "ax", "ay", "az")}
    some = (partners >= 0) & (np.abs(at[:, 2]) > 0.5) & np.isfinite(value["ax"])
    for names, true in (("u v w", FLOW(at)), ("ax ay az", acceleration(at))):
        for axis, name in enumerate(names.split()):
            std = tracks[f"{name}_std"].values
            off = np.abs(value[name] - true[:, axis])[some]
            assert 0.55 < (off < std[some]).mean() < 0.9, name
            assert (off < 2 * std[some]).mean() > 0.85, name
            weight = 1 / std[some] ** 2
            slope = (weight * value[name][some] * true[some, axis]).sum() / (weight * true[some, axis] ** 2).sum()
            assert slope == pytest.approx(1, abs=0.15), name
    depth = (tracks.z.values - at[:, 2])[some] / VOXEL_MM[2]
    assert np.sqrt((depth**2).mean()) < 0.08


def test_names_and_units_of_the_file(sequence):
    _, _, tracks = sequence
    assert [tracks[name].attrs["units"] for name in ("x", "u", "ax", "az_std")] == ["mm", "m s-1", "m s-2", "m s-2"]
    assert tracks.covariance.shape[1:] == (6, 6)
    assert len(tracks.attrs["jerk_m_s3"]) == 3
    assert tracks.time.attrs["units"] == "s"
    assert tracks.time.values == pytest.approx(tracks.frame.values * DT_S)
    assert tracks.attrs["frame"] == "camera"
    once = np.unique(np.stack([tracks.frame.values, tracks.track_id.values])[:, tracks.track_id.values >= 0], axis=1)
    assert once.shape[1] == (tracks.track_id.values >= 0).sum()
    assert np.isnan(tracks.ax.values[tracks.track_id.values < 0]).all()


def test_the_field_of_each_pair(sequence):
    folder, _, _ = sequence
    field = xarray.load_dataset(folder / "results" / "tracking" / "velocity.nc")
    assert field.sizes["time"] == FRAMES - 1
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    truth = FLOW(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
    for axis, name in enumerate("uvw"):
        off = (field[name].values - truth[..., axis])[field.valid.values == 1]
        assert np.sqrt((off**2).mean()) < 0.1 * np.sqrt((truth[..., axis] ** 2).mean()) + 2e-3, name


def test_later_frames_are_not_reconstructed(sequence, tmp_path):
    """Killed in the sixth frame, it goes on from there to the same tracks; four frames are reconstructed in all."""
    folder, _, tracks = sequence
    path = with_keys(folder, "again.toml", tmp_path / "out", tracking={"method": "multi-frame"})
    stages = []

    def killed(stage, done, total):
        stages.append(stage)
        if stage == "particles of frame-005.tif":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track(Experiment.load(path), killed)
    kept = sorted(each.name for each in (tmp_path / "out" / "tracking" / ".plenopiv" / "pairs").glob("*.npz"))
    assert kept == [f"particles-{k:04d}.npz" for k in range(5)]
    track(Experiment.load(path), lambda stage, done, total: stages.append(stage))
    made = {stage for stage in stages if stage.startswith("reconstruction")}
    assert made == {f"reconstruction of frame-{k:03d}.tif" for k in range(BEGUN)}
    written = tmp_path / "out" / "tracks.nc"
    assert xarray.load_dataset(written).equals(tracks)
    whole = written.read_bytes()
    written.unlink()
    track(Experiment.load(path))
    assert written.read_bytes() == whole


def test_a_jump_in_time_is_said_and_tracked_anew(sequence, tmp_path, monkeypatch):
    """The last two frames show other particles: the first of them is reconstructed, and so is the other, as no track
    tells velocities yet. The run is ended in the last frame and goes on: what was said before is in the summary. A pair
    without a field is set aside."""
    folder, _, _ = sequence
    names = [f"frame-{k:03d}.tif" for k in range(6)]
    simulate_sequence(
        tmp_path / "other", CAMERA, FLOW, 2, dt_s=DT_S, volume_mm=((-0.6, 0.6), (-0.6, 0.6), (-1.6, 1.6)),
        seeding=Seeding(0.4), rays=4000, seed=77,
    )  # fmt: skip
    for k in (0, 1):
        shutil.copy(tmp_path / "other" / f"frame-{k:03d}.tif", folder / f"other-{k}.tif")
    names += ["other-0.tif", "other-1.tif"]
    path = with_keys(
        folder, "jump.toml", tmp_path / "out", tracking={"method": "multi-frame"}, recording={"frames": names}
    )

    def killed(stage, done, total):
        if stage == "particles of other-1.tif":
            raise KeyboardInterrupt

    def failing(tracks, chain, table, dt_s, time_s, stage):
        if time_s == 2.5 * dt_s:
            raise PlenoPIVError("too few")
        return velocity_of_tracks(tracks, chain, table, dt_s, time_s, stage)

    anew = "other-0.tif: .* it is reconstructed, and tracked anew"
    with pytest.warns(match=anew), pytest.raises(KeyboardInterrupt):
        track(Experiment.load(path), killed)
    monkeypatch.setattr(track_smooth, "velocity_of_tracks", failing)
    with pytest.warns(match="pair 2: no field of its tracks: too few"):
        summary = track(Experiment.load(path)).summary
    assert any(re.search(anew, line) for line in summary["warnings"])
    without = {each["pair"]: each["reason"] for each in summary["set_aside"]}
    assert without.keys() == {2, 5}
    assert without[2] == "no field of its tracks: too few"
    assert without[5].endswith("are frames and max_displacement_mm right?")
    assert summary["quality"] == "doubtful"
    tracks = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    ids, frame = tracks.track_id.values, tracks.frame.values
    before, after = (set(ids[(frame == k) & (ids >= 0)]) for k in (5, 6))
    assert len(before & after) < 0.15 * len(before)
    assert (frame == 6).sum() > 50


def test_after_lost_frames_velocities_are_learnt_anew(sequence, tmp_path):
    """Three frames are blank: the frames after them have no tracks that tell how particles move."""
    folder, truth, _ = sequence
    names = [f"frame-{k:03d}.tif" for k in range(FRAMES)]
    for k in (4, 5, 6):
        names[k] = f"blank-{k}.tif"
        tifffile.imwrite(folder / names[k], np.full((320, 320), 60, np.uint16))
    path = with_keys(
        folder, "lost.toml", tmp_path / "out", tracking={"method": "multi-frame"}, recording={"frames": names}
    )
    with pytest.warns(match="blank"):
        track(Experiment.load(path))
    tracks = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    ids, frame = tracks.track_id.values, tracks.frame.values
    assert set(frame) == {0, 1, 2, 3, 7, 8}
    place = np.stack([tracks[name].values for name in "xyz"], -1)
    inside = (np.abs(truth[7:]) < (0.6, 0.6, 1.6)).all((0, 2)) & (np.abs(truth[7:, :, 2]) > 0.5).all(0)
    found = [np.flatnonzero(frame == k) for k in (7, 8)]
    of = [nearest(truth[k][inside], place[own]) for k, own in zip((7, 8), found, strict=True)]
    both = (of[0] >= 0) & (of[1] >= 0)
    assert both.mean() > 0.85
    before, after = (ids[own[partner[both]]] for own, partner in zip(found, of, strict=True))
    assert ((before == after) & (before >= 0)).mean() > 0.9
    field = xarray.load_dataset(tmp_path / "out" / "tracking" / "velocity.nc").isel(time=7)
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    true = FLOW(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
    for axis, name in enumerate("uvw"):
        off = (field[name].values - true[..., axis])[field.valid.values == 1]
        assert np.sqrt((off**2).mean()) < 0.15 * np.sqrt((true[..., axis] ** 2).mean()) + 4e-3, name


def test_what_is_said_is_what_the_file_holds(sequence):
    folder, _, tracks = sequence
    summary = json.loads((folder / "results" / "tracking" / "summary.json").read_text())
    assert sum(summary["particles"].values()) == tracks.sizes["obs"]
    ids, frame = tracks.track_id.values, tracks.frame.values
    for k, linked in enumerate(summary["linked"]):
        here, there = (set(ids[(frame == each) & (ids >= 0)]) for each in (k, k + 1))
        assert linked == len(here & there)


def test_pairs_of_pulses_are_refused(sequence, tmp_path):
    folder, _, _ = sequence
    content = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    content["output"]["directory"] = str(tmp_path / "out")
    content["recording"].pop("frames")
    content["recording"]["pairs"] = [["frame-000.tif", "frame-001.tif"], ["frame-002.tif", "frame-003.tif"]]
    content["tracking"] = {"method": "multi-frame"}
    (folder / "pairs.toml").write_text(tomli_w.dumps(json.loads(json.dumps(content))))
    with pytest.raises(PlenoPIVError, match=r'tracking\.method: "multi-frame" takes a sequence'):
        track(Experiment.load(folder / "pairs.toml"))
    few = with_keys(
        folder, "few.toml", tmp_path / "out", tracking={"method": "multi-frame"},
        recording={"frames": ["frame-000.tif", "frame-001.tif", "frame-002.tif"]},
    )  # fmt: skip
    with pytest.raises(PlenoPIVError, match="takes 4 frames or more, there are 3"):
        track(Experiment.load(few))
