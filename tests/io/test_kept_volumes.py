"""Volumes kept on disk: the same bits after, the same bytes twice, and one line about files that are damaged."""

import time

import h5py
import numpy as np
import pytest

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io import volumes
from plenopiv.io.volumes import read_volume, write_volume
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid((1.0, -2.0, 0.5), (0.1, 0.2, 0.4), (19, 6, 7))


@pytest.fixture(autouse=True)
def without_child(request, monkeypatch):
    """A child process takes 0.2 s a file; the tests of damage have it."""
    if "damage" not in request.node.name:
        monkeypatch.setattr(volumes, "damage", lambda path: "")


def blobs(shape, count=40, seed=0):
    """Clusters of voxels, as particles make them, of random intensity."""
    rng = np.random.default_rng(seed)
    dense = np.zeros(shape, np.float32)
    for k, j, i in zip(*(rng.integers(0, n, count) for n in shape), strict=True):
        part = dense[max(k - 2, 0) : k + 3, max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
        part[...] = rng.uniform(0.1, 4e4, part.shape)
    return dense


def sparse(dense, grid=GRID):
    mask = dense != 0
    return SparseVolume.from_mask(grid, mask).with_values(dense[mask])


def assert_same(read, written):
    assert read.grid == written.grid
    for name in ("row_start", "column", "values"):
        a, b = getattr(read, name), getattr(written, name)
        assert a.dtype == b.dtype, name
        assert a.tobytes() == b.tobytes(), name


@pytest.mark.parametrize("block", [volumes.BLOCK, 7])
def test_a_volume_comes_back_bit_for_bit(tmp_path, monkeypatch, block):
    monkeypatch.setattr(volumes, "BLOCK", block)
    volume = sparse(blobs(GRID.shape))
    write_volume(tmp_path / "volume.h5", volume)
    assert_same(read_volume(tmp_path / "volume.h5"), volume)


def test_any_float_is_kept_and_voxels_of_intensity_zero_too(tmp_path):
    volume = sparse(blobs(GRID.shape))
    values = volume.values.copy()
    values[:6] = 0.0, -0.0, 1e-45, np.float32(np.finfo(np.float32).max), -3.5, np.nextafter(np.float32(1), 2)
    write_volume(tmp_path / "volume.h5", volume.with_values(values))
    assert_same(read_volume(tmp_path / "volume.h5"), volume.with_values(values))


@pytest.mark.parametrize("block", [volumes.BLOCK, 3])
def test_long_empty_stretches_between_voxels(tmp_path, monkeypatch, block):
    """Steps just below, at and above what 16 bits hold, and many times it."""
    monkeypatch.setattr(volumes, "BLOCK", block)
    for gaps in ([1, 65534, 65535, 65536, 131070, 131071, 1], [65535 * 5, 1, 65535 * 3 + 1], [65536], [700_000]):
        grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (3, 500, 700))
        mask = np.zeros(grid.size, bool)
        mask[np.cumsum(gaps) - 1] = True
        volume = SparseVolume.from_mask(grid, mask.reshape(grid.shape), 2.5)
        write_volume(tmp_path / "volume.h5", volume)
        assert_same(read_volume(tmp_path / "volume.h5"), volume)


def test_an_empty_volume_and_a_full_one(tmp_path):
    for volume in (sparse(np.zeros(GRID.shape, np.float32)), SparseVolume.from_mask(GRID, np.ones(GRID.shape, bool))):
        write_volume(tmp_path / "volume.h5", volume)
        assert_same(read_volume(tmp_path / "volume.h5"), volume)


def test_the_same_volume_makes_the_same_bytes_at_another_time(tmp_path):
    volume = sparse(blobs(GRID.shape))
    write_volume(tmp_path / "a.h5", volume)
    time.sleep(1.1)  # HDF5's times are whole seconds
    write_volume(tmp_path / "b.h5", volume)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_voxel_takes_less_than_five_bytes(tmp_path):
    """Random mantissas, clusters like particles': of reconstructed ones docs/guide.md has the size."""
    grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (60, 150, 200))
    volume = sparse(blobs(grid.shape, 600), grid)
    write_volume(tmp_path / "volume.h5", volume)
    assert (tmp_path / "volume.h5").stat().st_size < 5 * volume.values.size


def test_damage_anywhere_is_one_line_or_makes_no_difference(tmp_path, monkeypatch):
    """A file of one block: its headers and both lists have check sums. The child process sees damage first; here the
    file is read past it."""
    monkeypatch.setattr(volumes, "damage", lambda path: "")
    path = tmp_path / "volume.h5"
    volume = sparse(blobs(GRID.shape))
    write_volume(path, volume)
    whole, rng = path.read_bytes(), np.random.default_rng(3)
    said = []
    for place in rng.choice(len(whole), 150, replace=False):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << rng.integers(8))]) + whole[place + 1 :])
        try:
            assert_same(read_volume(path), volume)
        except PlenoPIVError as error:
            said.append(str(error))
    assert len(said) > 75  # the others fall into space that nothing uses
    assert all(line.startswith(f"{path}: is no volume of plenopiv or is damaged (") for line in said)
    assert not any("\n" in line for line in said)


@pytest.mark.parametrize("length", [0, 100, 700, -1])
def test_damage_of_a_file_cut_short(tmp_path, length):
    path = tmp_path / "volume.h5"
    write_volume(path, sparse(blobs(GRID.shape)))
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(PlenoPIVError, match=r"volume\.h5: is no volume of plenopiv or is damaged"):
        read_volume(path)


def changed(path, **lists):
    """Write other lists or attributes into a file."""
    with h5py.File(path, "r+") as file:
        for name, values in lists.items():
            if name in file:
                del file[name]
                file[name] = values
            else:
                file.attrs[name] = values


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": np.bytes_(b"something")}, "does not say that it is one"),
        ({"version": 2}, "its version is 2; this program reads 1"),
        ({"shape": np.array([19, 6, 0])}, "its grid is none"),
        ({"shape": np.array([19, 6, 1 << 40])}, "its grid is none"),
        ({"shape": np.array([65535, 65535, 2])}, "its grid is none"),
        ({"voxel_mm": np.array([0.1, np.nan, 0.1])}, "its grid is none"),
        ({"shape": np.array([1, 1, 7])}, "lists more voxels than there are"),
        ({"intensity": np.ones(3, np.float32)}, "lists more voxels than there are"),
        ({"intensity": np.ones(900, np.float32)}, "it has 900 intensities of"),
        ({"intensity": np.ones(3)}, "intensity is no list of float32"),
        ({"step": np.zeros((2, 2), np.uint16)}, "step is no list of uint16"),
    ],
)
def test_lists_that_contradict_one_another(tmp_path, change, said):
    path = tmp_path / "volume.h5"
    write_volume(path, sparse(blobs(GRID.shape)))
    changed(path, **change)
    with pytest.raises(PlenoPIVError, match=said):
        read_volume(path)


def test_files_that_are_none(tmp_path):
    with pytest.raises(PlenoPIVError, match="no such file"):
        read_volume(tmp_path / "none.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.arange(3)
    with pytest.raises(PlenoPIVError, match="does not say that it is one"):
        read_volume(tmp_path / "other.h5")
    with pytest.raises(PlenoPIVError, match="cannot be written"):
        write_volume(tmp_path / "no" / "folder.h5", sparse(blobs(GRID.shape)))


def test_export_makes_a_file_for_paraview_of_a_kept_volume(tmp_path, capsys):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")
    volume = sparse(blobs(GRID.shape))
    write_volume(tmp_path / "volume.h5", volume)
    assert main(["export", str(tmp_path / "volume.h5"), str(tmp_path / "volume.vtkhdf")]) == 0
    mesh = pyvista.read(tmp_path / "volume.vtkhdf")
    np.testing.assert_array_equal(mesh["intensity"].reshape(GRID.shape), volume.dense().values)
    np.testing.assert_allclose([mesh.origin, mesh.spacing], [GRID.first_mm, GRID.voxel_mm])
    capsys.readouterr()
    assert main(["export", str(tmp_path / "volume.h5"), str(tmp_path / "plane.txt"), "--z", "0"]) == 2
    line = capsys.readouterr().err
    assert "OpenPIV's files hold vectors" in line
    assert line.count("\n") == 1
    assert not (tmp_path / "plane.txt").exists()
