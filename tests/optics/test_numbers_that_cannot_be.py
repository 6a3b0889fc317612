"""Cameras and options that cannot be are refused where they are given."""

from math import nan

import pytest

import plenopiv
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.recording import find_frames
from plenopiv.run.series import run
from plenopiv.sensor import Sensor


@pytest.mark.parametrize(("turned", "offset"), [(nan, (0.0, 0.0)), (0.0, (nan, 0.0)), (0.0, 1.0), (0.0, (1.0,))])
def test_a_lattice_has_a_rotation_and_an_offset(turned, offset):
    with pytest.raises(PlenoPIVError, match=r"lattice: rotation_rad = .*, offset_mm = .*; give a number, and \(s, t\)"):
        Lattice("hexagonal", 0.077, turned, offset)


@pytest.mark.parametrize(("bits", "black"), [(40, 0.0), (17, 0.0), (12, 5000.0), (8, 255.0)])
def test_a_dark_pixel_is_below_full_scale_of_16_bits_at_most(bits, black):
    with pytest.raises(
        PlenoPIVError, match=r"sensor: .* bits and a black level of .*; files hold 16 bits at most, and"
    ):
        Sensor(10, 10, 0.005, bits, black)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pairs": (-1, 1)}, r"pairs: \(-1, 1\), give the first and the last one, counted from 0"),
        ({"pairs": (3, 1)}, r"pairs: \(3, 1\), give the first"),
        ({"memory_gb": nan}, "memory: nan GB, give a positive number"),
        ({"memory_gb": -1}, "memory: -1 GB, give a positive number"),
    ],
)
def test_options_are_looked_at_first(options, words):
    """Before the experiment is."""
    with pytest.raises(PlenoPIVError, match=words):
        run(None, **options)


def test_a_file_s_name_is_an_experiment_too(tmp_path):
    for name in (str(tmp_path / "none.toml"), tmp_path / "none.toml"):
        with pytest.raises(PlenoPIVError, match=r"none\.toml: no such file"):
            plenopiv.process(name)
    (tmp_path / "a.tif").touch()
    assert [path.name for path in find_frames(str(tmp_path), "*.tif")] == ["a.tif"]
