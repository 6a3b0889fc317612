"""plenopiv track on a small simulated recording of a uniform flow."""

import json
import shutil

import numpy as np
import pytest
import tifffile
import xarray
from experiment_files import with_keys
from particle_scenes import nearest
from uniform_recording import VELOCITY_M_S, simulated

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.run import track_pair
from plenopiv.run.space import space_of
from plenopiv.run.track import track
from plenopiv.run.track_field import velocity_of_tracks

pytestmark = pytest.mark.full  # a recording is simulated, reconstructed, tracked and linked


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The folder of a recording that was tracked, and its tracks."""
    folder = tmp_path_factory.mktemp("tracked") / "recording"
    simulated(folder)
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


def test_the_field_of_the_tracks(recording):
    folder, tracks = recording
    field = xarray.load_dataset(folder / "results" / "tracking" / "velocity.nc")
    assert "peak_ratio" not in field
    assert field.u.dims == ("time", "z", "y", "x")
    assert field.u_raw.equals(field.u)
    assert field.valid.mean() > 0.9
    for name, true in zip("uvw", VELOCITY_M_S, strict=True):
        off = (field[name] - true).values[field.valid.values == 1]
        assert np.median(np.abs(off)) < 0.5 * np.nanmedian(tracks[f"{name}_std"])
        assert (np.abs(off) < 3 * field[f"{name}_std"].values[field.valid.values == 1]).mean() > 0.8


def test_what_is_there_is_kept_and_made_again_where_it_is_damaged(recording, capsys):
    folder, tracks = recording
    path = folder / "results" / "tracks.nc"
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    assert main(["track", str(folder / "experiment.toml")]) == 0
    assert "complete, and nothing has changed" in capsys.readouterr().err
    assert xarray.load_dataset(path).equals(tracks)


def test_tracks_of_other_keys_are_not_replaced_unasked(recording, capsys):
    folder, _ = recording
    other = with_keys(folder, "other.toml", folder / "results", tracking={"grid_mm": 0.3})
    assert main(["track", str(other)]) == 2
    assert "holds a run of other inputs (tracking.grid_mm: was null, is 0.3)" in capsys.readouterr().err


def test_a_series_with_a_frame_without_particles(recording, tmp_path, capsys):
    """Frames a, b, a and a dark one: b is in two pairs, the last pair is set aside."""
    folder, _ = recording
    tifffile.imwrite(folder / "dark.tif", np.full((320, 320), 60, np.uint16))
    series = with_keys(
        folder,
        "series.toml",
        tmp_path / "out",
        recording={"frames": ["a.tif", "b.tif", "again.tif", "dark.tif"]},
    )
    shutil.copy(folder / "a.tif", folder / "again.tif")
    assert main(["track", str(series)]) == 3
    assert "1 of 3 pairs set aside" in capsys.readouterr().out
    made = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    assert np.unique(made.frame).tolist() == [0, 1, 2]
    ids, frame = made.track_id.values, made.frame.values
    shorter = with_keys(
        folder, "shorter.toml", tmp_path / "short", recording={"frames": ["a.tif", "b.tif", "again.tif"]}
    )
    assert main(["track", str(shorter)]) == 0
    tracks = xarray.load_dataset(tmp_path / "short" / "tracks.nc")
    same = tracks.track_id.values[tracks.frame.values == 0] >= 0
    assert (ids[frame == 0] >= 0).tolist() == same.tolist()
    seen = np.unique(ids[ids >= 0], return_counts=True)[1]
    assert (seen == 3).mean() > 0.9
    assert np.nanmedian(made.u.values[frame == 1]) == pytest.approx(-VELOCITY_M_S[0], abs=2e-3)  # to the next frame
    field = xarray.load_dataset(tmp_path / "out" / "tracking" / "velocity.nc")
    assert field.w.mean(("z", "y", "x")).values == pytest.approx([0.17, -0.17, np.nan], abs=4e-3, nan_ok=True)


def test_particles_behind_water(recording, tmp_path):
    """The same images as if there were water, little enough that its aberration, which they lack, is small: depths are
    1.33 times as large, and so are their error bars."""
    folder, tracks = recording
    volume = Experiment.load(folder / "experiment.toml").volume
    deep = {"z_mm": [1.33 * z for z in volume.z_mm], "voxel_mm": [*volume.voxel_mm[:2], 1.33 * volume.voxel_mm[2]]}
    water = {"refractive_index": 1.33, "fluid_mm": 5.0}
    path = with_keys(folder, "water.toml", tmp_path / "out", volume=deep, medium=water)
    experiment = Experiment.load(path)
    track(experiment)
    made = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    assert xarray.load_dataset(tmp_path / "out" / "tracking" / "velocity.nc").attrs["frame"] == "laboratory"
    first, air = made.isel(obs=made.frame == 0), tracks.isel(obs=tracks.frame == 0)
    space = space_of(experiment, experiment.recording())
    seen = space.to_lens(np.stack([first[name].values for name in "xyz"], -1))
    beyond = np.stack([air[name].values for name in "xyz"], -1)
    beyond, std = beyond[np.abs(beyond[:, 2]) > 0.6], air.z_std.values[np.abs(beyond[:, 2]) > 0.6]
    partner = nearest(beyond, seen)
    assert (partner >= 0).mean() > 0.95
    ratio = first.z_std.values[partner[partner >= 0]] / std[partner >= 0]
    assert np.median(ratio) == pytest.approx(1.33, abs=0.03)


def test_particles_that_leave_the_volume_between_the_frames(recording, tmp_path):
    """Of a volume within what is lit; frames a, b and a again: who comes in goes out again."""
    folder, _ = recording
    shutil.copy(folder / "a.tif", folder / "again.tif")
    narrow = with_keys(
        folder,
        "narrow.toml",
        tmp_path / "out",
        recording={"frames": ["a.tif", "b.tif", "again.tif"]},
        volume={"x_mm": [-0.45, 0.45]},
    )
    assert main(["--quiet", "track", str(narrow)]) == 0
    made = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    ids, frame = made.track_id.values, made.frame.values
    in_frame = [set(ids[(frame == k) & (ids >= 0)].tolist()) for k in range(3)]
    assert in_frame[0] - in_frame[1]
    assert in_frame[1] - in_frame[0]
    x = [dict(zip(ids[frame == k].tolist(), made.x.values[frame == k].tolist(), strict=True)) for k in range(3)]
    both = sorted(in_frame[0] & in_frame[1])
    assert len(both) > 20
    moved = np.array([x[1][one] - x[0][one] for one in both])
    assert moved == pytest.approx(1e3 * 5e-4 * VELOCITY_M_S[0], abs=0.03)
    back = np.array([x[2][one] - x[0][one] for one in sorted(in_frame[0] & in_frame[2])])
    assert np.abs(back).max() < 0.03


def test_a_recording_that_is_unusable_is_not_tracked_unasked(recording, tmp_path, capsys):
    """Both frames are one image: what moves is nothing, and would pass for a flow at rest."""
    folder, _ = recording
    shutil.copy(folder / "a.tif", folder / "same.tif")
    path = with_keys(folder, "same.toml", tmp_path / "out", recording={"frames": ["a.tif", "same.tif"]})
    assert main(["track", str(path)]) == 2
    assert "a.tif and same.tif are one image" in capsys.readouterr().err
    assert not (tmp_path / "out" / "tracks.nc").exists()
    assert main(["track", "--force", str(path)]) == 0
    assert "displacements of up to (" in capsys.readouterr().out
    for name in ("tracks.nc", "tracking/velocity.nc"):
        with xarray.open_dataset(tmp_path / "out" / name) as made:
            assert made.attrs["quality"] == "forced"


def test_too_few_links_for_a_field_are_tracks_all_the_same(recording, tmp_path, capsys, monkeypatch):
    """Of one pair and of a series. A field of before is gone then, and what is complete stays so."""
    folder, tracks = recording

    def failing(*arguments):
        raise PlenoPIVError("too few")

    out = tmp_path / "out" / "tracking"
    pair = with_keys(folder, "pair.toml", tmp_path / "out")
    assert main(["track", str(pair)]) == 0
    assert (out / "velocity.nc").exists()
    monkeypatch.setattr(track_pair, "velocity_of_tracks", failing)
    capsys.readouterr()
    for _ in range(2):
        assert main(["track", "--overwrite", str(pair)]) == 3
        said = capsys.readouterr().out
        assert "no field of its tracks: too few" in said
        assert "displacements of up to (" in said
        assert "velocity.nc" not in said
        assert not (out / "velocity.nc").exists()
    assert main(["track", str(pair)]) == 3
    assert xarray.load_dataset(tmp_path / "out" / "tracks.nc").equals(tracks)
    series = with_keys(folder, "abab.toml", tmp_path / "two", recording={"frames": ["a.tif", "b.tif", "c.tif"]})
    shutil.copy(folder / "a.tif", folder / "c.tif")
    assert main(["--json", "track", "--force", str(series)]) == 3
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["velocity"] is None
    assert len(facts["set_aside"]) == 2
    assert xarray.load_dataset(tmp_path / "two" / "tracks.nc").sizes["obs"] > tracks.sizes["obs"]


def test_a_pair_of_a_series_that_is_unusable_is_set_aside(recording, tmp_path, capsys, monkeypatch):
    """So is one whose links make no field, but its tracks are there."""
    folder, _ = recording

    def failing(tracks, chain, table, dt_s, time_s, stage):
        if time_s == 3.5 * dt_s:
            raise PlenoPIVError("too few")
        return velocity_of_tracks(tracks, chain, table, dt_s, time_s, stage)

    monkeypatch.setattr(track_pair, "velocity_of_tracks", failing)
    frames = []
    for name, of in zip("ABCDE", "abbab", strict=True):
        (folder / name).mkdir()
        shutil.copy(folder / f"{of}.tif", folder / name / "1.tif")
        frames.append(f"{name}/1.tif")
    path = with_keys(folder, "series.toml", tmp_path / "out", recording={"frames": frames})
    assert main(["track", str(path)]) == 3
    assert "are one image" in capsys.readouterr().err
    summary = json.loads((tmp_path / "out" / "tracking" / "summary.json").read_text())
    assert [aside["pair"] for aside in summary["set_aside"]] == [1, 3]
    assert summary["set_aside"][1]["reason"] == "no field of its tracks: too few"
    assert summary["quality"] == "doubtful"
    assert list(summary["particles"]) == frames
    made = xarray.load_dataset(tmp_path / "out" / "tracks.nc")
    assert (made.track_id.values[made.frame.values == 4] >= 0).mean() > 0.9
    assert np.isnan(xarray.load_dataset(tmp_path / "out" / "tracking" / "velocity.nc").u[[1, 3]]).all()
    tracks = tmp_path / "out" / "tracks.nc"
    whole = tracks.read_bytes()
    tracks.unlink()
    assert main(["track", str(path)]) == 3
    assert tracks.read_bytes() == whole
