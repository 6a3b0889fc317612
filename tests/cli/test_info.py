"""What ``plenopiv info`` says of results and of images of every kind."""

import h5py
import numpy as np
import pytest
import xarray
from PIL import Image

from plenopiv.cli.info import info
from plenopiv.errors import PlenoPIVError
from plenopiv.io.netcdf import write_dataset
from plenopiv.io.tracks_file import VECTORS, write_tracks

COUNTS = (60 + np.arange(48).reshape(6, 8)).astype(np.uint16)


def test_tracks(tmp_path):
    names = ["x", "y", "z", *" ".join(VECTORS.values()).split()]
    variables = {name: ("obs", np.array([-1.0, 0.5, 2.0, 0.25, 1.0])) for name in names}
    variables["u"] = "obs", np.array([np.nan, 0.2, -0.1, np.nan, np.nan])
    variables |= {"frame": ("obs", [0, 1, 2, 1, 2]), "track_id": ("obs", [4, 4, 4, -1, 7])}
    write_tracks(tmp_path / "tracks.nc", xarray.Dataset(variables))
    said = info(tmp_path / "tracks.nc")
    assert "5, in 3 frames" in said
    assert "2, the longest of 3 frames; 80.0 % of the particles on one" in said
    assert "-0.1 to +0.2 m/s, mean +0.05" in said
    assert "-1 to 2 mm" in said


@pytest.mark.parametrize("phases", [0, 2])
def test_statistics(tmp_path, phases):
    dims, shape = ("z", "y", "x"), (2, 3, 4)
    if phases:
        dims, shape = ("phase", *dims), (phases, *shape)
    variables = {f"{name}_mean": (dims, np.full(shape, -0.25)) for name in "uvw"}
    variables |= {f"{name}_rms": (dims, np.linspace(0.5, 1, int(np.prod(shape))).reshape(shape)) for name in "uvw"}
    axes = {axis: np.arange(n, dtype=float) for axis, n in zip("zyx", (2, 3, 4), strict=True)}
    write_dataset(tmp_path / "statistics.nc", xarray.Dataset(variables, axes, {"pairs": 30}), {})
    said = info(tmp_path / "statistics.nc")
    assert f"of 30 pairs{', 2 phases' * bool(phases)}; 4 x 3 x 2 places along x, y, z" in said
    assert "mean -0.25 to -0.25 m/s; RMS 0.5 to 1 m/s" in said


def test_a_file_of_others_is_no_statistics(tmp_path):
    write_dataset(tmp_path / "other.nc", xarray.Dataset({f"{name}_rms": ("n", np.ones(3)) for name in "uvw"}), {})
    with pytest.raises(PlenoPIVError, match=r"other\.nc: has no u, v, w, valid, so it is no velocity field"):
        info(tmp_path / "other.nc")


def test_images_of_every_kind(tmp_path):
    Image.fromarray(COUNTS).save(tmp_path / "dark.png")
    np.save(tmp_path / "dark.npy", COUNTS)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["frames"] = np.stack([COUNTS, COUNTS])
    for name, first in (("dark.png", "size"), ("dark.npy", "size"), ("run.h5::frames", "images      2; of the first:")):
        said = info(tmp_path / name)
        assert said.startswith(first), name
        assert "8 x 6 px (columns x rows), uint16" in said
        assert "60 to 107; 1 %: 60, median 84" in said


def test_what_is_none_of_these(tmp_path):
    (tmp_path / "notes.txt").write_text("a note")
    with pytest.raises(PlenoPIVError, match=r"notes\.txt: is no image file that is known; TIFF, PNG, NumPy"):
        info(tmp_path / "notes.txt")
