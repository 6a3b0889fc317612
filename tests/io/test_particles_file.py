"""Particles of a frame, kept and read back."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.io.particles_file import read_particles, write_particles


def test_what_is_written_is_read(tmp_path):
    values = {"position_mm": np.random.default_rng(0).normal(size=(4, 3)), "track": np.arange(4), "dark": 2.5}
    write_particles(tmp_path / "a.npz", values)
    read = read_particles(tmp_path / "a.npz")
    assert read.keys() == values.keys()
    assert all((read[name] == values[name]).all() for name in values)
    assert read["track"].dtype == np.int64
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_damaged_file_is_named(tmp_path):
    path = tmp_path / "a.npz"
    write_particles(path, {"track": np.arange(100)})
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(PlenoPIVError, match=r"a\.npz: is damaged"):
        read_particles(path)
    with pytest.raises(PlenoPIVError, match=r"none\.npz"):
        read_particles(tmp_path / "none.npz")
