"""HDF5 files tried in a child process: whole, damaged, larger than they are, endless, and such that HDF5 crashes."""

import os
import time
import zlib

import h5py
import numpy as np
import pytest

from plenopiv import hdf5

VALUES = np.random.default_rng(4).random((20, 30))


@pytest.fixture
def path(tmp_path):
    """A whole file, its folder's name no ASCII."""
    folder = tmp_path / "Läufe 粒"
    folder.mkdir()
    with h5py.File(folder / "a b.h5", "w") as file:
        file.create_dataset("run/values", data=VALUES, chunks=(5, 30), compression="gzip")
        file["run"].attrs["units"] = "m"
    return folder / "a b.h5"


def test_a_whole_file_is_tried_once(path, monkeypatch):
    began = time.perf_counter()
    assert hdf5.damage(path) == ""
    first = time.perf_counter() - began
    monkeypatch.setattr(hdf5, "CHILD", path.parent / "none.py")
    assert hdf5.damage(path) == ""
    os.utime(path, ns=(1, 1))  # another file by now, as far as anyone can tell
    assert hdf5.damage(path) != ""
    assert first < 20


def test_what_the_library_raises_is_told(path):
    path.write_bytes(b"no HDF5 at all")
    assert "OSError" in hdf5.damage(path)
    path.write_bytes(b"")
    assert "OSError" in hdf5.damage(path)


def test_damaged_data_are_seen_though_the_header_is_whole(path):
    content = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        chunk = file["run/values"].id.get_chunk_info(2)
    content[chunk.byte_offset + 10 : chunk.byte_offset + 60] = bytes(50)
    path.write_bytes(content)
    assert "OSError" in hdf5.damage(path)


@pytest.mark.parametrize("stored", [False, True])
def test_more_data_than_a_file_holds_are_not_read(path, stored):
    """Terabytes that were never written, and gigabytes of zeros packed into a few megabytes."""
    with h5py.File(path, "r+") as file:
        if stored:
            made = file.create_dataset("zeros", shape=(1 << 31,), chunks=(1 << 31,), dtype="u1", compression="gzip")
            made.id.write_direct_chunk((0,), zlib.compress(bytes(1 << 20)))
        else:
            file.create_dataset("none", shape=(10**6, 10**6), chunks=(100, 100), dtype="f8")
    assert "GB of data, more than it can hold" in hdf5.damage(path)


def program(monkeypatch, tmp_path, text):
    child = tmp_path / "child.py"
    child.write_text(text)
    monkeypatch.setattr(hdf5, "CHILD", child)


@pytest.mark.parametrize(
    ("waits", "said"),
    [
        ("ctypes.CDLL(None).pause()", "it was not read within 2 s: a busy disk, or a network's? run again"),
        ("while True: pass", "HDF5 does not come back from it within 1 s"),
    ],
)
def test_a_file_that_hdf5_does_not_come_back_from(path, monkeypatch, tmp_path, waits, said):
    """The limits that the child sets itself, of a read that never returns: of the processor, and of the clock."""
    real = hdf5.CHILD.read_text()
    assert "def read(path: str, kind: str) -> None:" in real
    endless = real.replace("    allowed = SPARE", f"    import ctypes\n    {waits.strip()}\n    allowed = SPARE")
    program(monkeypatch, tmp_path, endless)
    monkeypatch.setattr(hdf5, "TRY_S", 1)
    monkeypatch.setattr(hdf5, "WAIT_S", 2 if "pause" in waits else 60)
    began = time.perf_counter()
    assert hdf5.damage(path) == said
    assert time.perf_counter() - began < 20


def test_a_file_that_hdf5_crashes_on(path, monkeypatch, tmp_path):
    program(monkeypatch, tmp_path, "import os; os.abort()")
    assert hdf5.damage(path) == "HDF5 crashes on it"


def test_without_a_python_to_run_nothing_is_tried(path, monkeypatch):
    path.write_bytes(b"no HDF5 at all")
    monkeypatch.setattr(hdf5.sys, "executable", "")
    assert hdf5.damage(path) == ""


def test_frames_that_pack_well_are_whole(path):
    """Images that are dark but for a few pixels; a field of vectors is never so empty, and is loaded whole."""
    with h5py.File(path, "w") as file:
        frames = file.create_dataset("frames", (60, 2000, 2000), np.uint8, chunks=(1, 2000, 2000), compression="gzip")
        frames[0, 7, 9] = 200
        dark = zlib.compress(bytes(4_000_000), 9)
        for frame in range(1, 60):
            frames.id.write_direct_chunk((frame, 0, 0), dark)
    assert 240e6 / path.stat().st_size > 200
    assert hdf5.damage(path) == ""
    assert "more than it can hold" in hdf5.damage(path, netcdf=True)
