"""Tracks of several pairs put together, and read back by VTK itself."""

import numpy as np
import pytest
import xarray as xr

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io.tracks_file import read_tracks, write_tracks, write_tracks_vtkhdf
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import Links
from plenopiv.tracking.smoothing import Motion
from plenopiv.tracking.tracks import joined, smooth_dataset, tracks_dataset
from plenopiv.tracking.trajectories import Trajectories

DT_S = 1e-3


def particles(x_mm):
    """Particles of a frame in a row, at other depths."""
    n = len(x_mm)
    position = np.column_stack([x_mm, np.arange(n), -np.arange(n)]).astype(float)
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4, 1.0]), (n, 1, 1))
    return FrameParticles(position, np.full(n, 100.0), covariance, np.ones(n), 1.0)


def links(*pairs):
    """Links between particles of two frames, by their numbers."""
    a, b = np.array(pairs, np.int64).reshape(-1, 2).T
    return Links(a, b, np.zeros(len(a)), np.ones(3))


@pytest.fixture(scope="module")
def tracks():
    """Frames 0, 1 and 2: a particle in all of them, one in the first two, one in the last two, one alone in each."""
    frames = [particles([0.0, 1.0, 9.0]), particles([0.5, 1.5, 3.0, 9.0]), particles([3.7, 1.2, 9.0])]
    first = tracks_dataset([(0, frames[0]), (1, frames[1])], [(0, 1, links((0, 0), (1, 1)))], DT_S)
    second = tracks_dataset([(1, frames[1]), (2, frames[2])], [(1, 2, links((1, 1), (2, 0)))], DT_S)
    return joined([first, second])


def test_frames_that_two_pairs_share_are_there_once(tracks):
    assert tracks.frame.values.tolist() == [0] * 3 + [1] * 4 + [2] * 3
    assert tracks.track_id.values.tolist() == [0, 1, -1, 0, 1, 2, -1, 2, 1, -1]
    assert tracks.x.values.tolist() == [0.0, 1.0, 9.0, 0.5, 1.5, 3.0, 9.0, 3.7, 1.2, 9.0]


def test_velocity_is_that_to_the_next_frame(tracks):
    u = [0.5, 0.5, np.nan, 0.5, -0.3, 0.7, np.nan, 0.7, -0.3, np.nan]
    np.testing.assert_allclose(tracks.u.values, u)
    np.testing.assert_allclose(tracks.u_std.values, np.where(np.isnan(u), np.nan, np.sqrt(2e-4)))
    np.testing.assert_allclose(tracks.covariance.values[4, 0, 3], -1e-4)  # of the link to frame 2, not of that from 0


def test_ends_of_links_that_are_not_in_the_volume_leave_the_others_as_they_are():
    """One particle comes in, one goes out, two stay; of a last pair nothing is left in the second frame."""
    frames = [particles([0.0, 1.0, 2.0, 3.0]), particles([0.5, 1.5, 2.5, 3.5]), particles([0.7])]
    first = tracks_dataset([(0, frames[0]), (1, frames[1])], [(0, 1, links((0, 0), (1, 1), (2, 2), (3, 3)))], DT_S)
    second = tracks_dataset([(1, frames[1]), (2, frames[2])], [(1, 2, links((0, 0)))], DT_S)
    inside = [first.isel(obs=[1, 2, 3, 4, 5, 6]), second.isel(obs=[0, 1, 2])]
    whole = joined(inside)
    assert whole.frame.values.tolist() == [0, 0, 0, 1, 1, 1]
    assert whole.track_id.values.tolist() == [1, 2, 3, 0, 1, 2]
    np.testing.assert_allclose(whole.u.values, [0.5, 0.5, 0.5, 0.2, 0.5, 0.5])
    assert joined([inside[1].isel(obs=[0])]).track_id.values.tolist() == [0]
    assert joined([first.isel(obs=[7])]).track_id.values.tolist() == [0]
    assert joined([first.isel(obs=[]), second.isel(obs=[])]).sizes["obs"] == 0


def test_vtk_reads_tracks_back(tracks, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")
    write_tracks(tmp_path / "tracks.nc", tracks)
    assert main(["--quiet", "export", str(tmp_path / "tracks.nc"), str(tmp_path / "tracks.vtkhdf")]) == 0
    mesh = pyvista.read(tmp_path / "tracks.vtkhdf")
    np.testing.assert_allclose(mesh.points, np.stack([tracks[axis].values for axis in "xyz"], -1))
    np.testing.assert_allclose(mesh["velocity"], np.stack([tracks[axis].values for axis in "uvw"], -1), rtol=1e-6)
    np.testing.assert_array_equal(mesh["track_id"], tracks.track_id)
    assert mesh.n_verts == 10
    lines, ends = [], iter(mesh.lines)
    for count in ends:
        lines.append([next(ends) for _ in range(count)])
    assert lines == [[0, 3], [1, 4, 8], [5, 7]]


@pytest.fixture(scope="module")
def smooth():
    """Two particles in two frames 1 ms apart: 0.5 mm a frame is 0.5 m/s, 0.002 mm a frame^2 is 2 m/s^2."""
    frames = [particles([0.0, 1.0]), particles([0.5, 9.0])]
    mean = np.zeros((4, 9))
    mean[:, :3] = np.concatenate([one.position_mm for one in frames])
    mean[:, 3:] = 0.5, -0.25, 0.125, 0.002, -0.004, 0.006
    mean[3, 3:] = np.nan
    covariance = np.tile(np.diag([1e-4, 1e-4, 4e-4, 1e-2, 1e-2, 4e-2, 1e-6, 4e-6, 9e-6]), (4, 1, 1))
    covariance[:, 0, 3] = covariance[:, 3, 0] = 5e-4
    motion = Motion(*(np.ones(3),) * 5)
    track = np.array([0, 1, 0, -1])
    found = Trajectories(np.array([0, 0, 1, 1]), track, mean, covariance, motion)
    return smooth_dataset([(0, frames[0]), (1, frames[1])], found, DT_S)


def test_units_of_smooth_tracks(smooth):
    assert [float(smooth[name][0]) for name in ("u", "v", "w")] == pytest.approx([0.5, -0.25, 0.125])
    assert [float(smooth[name][0]) for name in ("ax", "ay", "az")] == pytest.approx([2.0, -4.0, 6.0])
    assert [float(smooth[f"a{axis}_std"][0]) for axis in "xyz"] == pytest.approx([1.0, 2.0, 3.0])
    assert [float(smooth[f"{name}_std"][0]) for name in "zw"] == pytest.approx([0.02, 0.2])
    assert float(smooth.covariance[0, 0, 3]) == pytest.approx(5e-4)  # mm m/s at 1 ms a frame
    assert smooth.track_id.values.tolist() == [0, 1, 0, -1]
    assert np.isnan(smooth.ax[3])


def test_accelerations_in_paraview(smooth, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")
    write_tracks_vtkhdf(tmp_path / "tracks.vtkhdf", smooth)
    mesh = pyvista.read(tmp_path / "tracks.vtkhdf")
    np.testing.assert_allclose(mesh["acceleration"][0], [2.0, -4.0, 6.0], rtol=1e-6)
    np.testing.assert_allclose(mesh["acceleration_std"][1], [1.0, 2.0, 3.0], rtol=1e-6)


def test_what_holds_no_tracks_is_refused(tracks, tmp_path):
    xr.Dataset({"x": ("obs", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(PlenoPIVError, match=r"other\.nc: is no file of tracks or is damaged"):
        read_tracks(tmp_path / "other.nc")
    with pytest.raises(PlenoPIVError, match=r"none\.nc: no such file; plenopiv track writes tracks\.nc"):
        read_tracks(tmp_path / "none.nc")


def test_openpiv_takes_no_tracks(tracks, tmp_path, capsys):
    write_tracks(tmp_path / "tracks.nc", tracks)
    assert main(["export", str(tmp_path / "tracks.nc"), str(tmp_path / "plane.txt"), "--z", "0"]) == 2
    assert ".txt files hold fields, tracks.nc holds tracks; name a .vtkhdf file" in (capsys.readouterr().err)
