"""docs/other-programs.md: its commands and its Python as written, on a small field and a small volume."""

import re
import shlex
import sys
import types
from pathlib import Path

import numpy as np
import pandas
import pytest
import scipy.io
import xarray as xr

from plenopiv.cli import main
from plenopiv.io import write_velocity
from plenopiv.io.volumes import write_volume
from plenopiv.volume import SparseVolume, VoxelGrid

PAGE = (Path(__file__).parents[2] / "docs" / "other-programs.md").read_text()
DIMS = ("time", "z", "y", "x")


def recipe(heading, language="python"):
    """The code below a heading."""
    part = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)[1]
    return re.search(rf"^```{language}\n(.*?)^```", part, re.DOTALL | re.MULTILINE)[1]


@pytest.fixture
def run7(tmp_path, monkeypatch):
    """A rotation about z at 100 1/s, one vector replaced; a volume of one bright voxel."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run7" / "results").mkdir(parents=True)
    axes = {"time": [0.0005], "z": [0.0, 0.5, 1.0], "y": [-1.0, 0.0, 1.0, 2.0], "x": np.arange(5) - 2.0}
    zero = np.zeros((1, 3, 4, 5))
    x, y = zero + axes["x"], zero + np.reshape(axes["y"], (4, 1))
    valid = np.ones(zero.shape, np.int8)
    valid[0, 0, 0, 0] = 0
    values = {"u": -0.1 * y, "v": 0.1 * x, "w": zero + 0.5, "u_std": zero, "v_std": zero, "w_std": zero + 0.01}
    variables = {name: (DIMS, value, {"units": "m s-1"}) for name, value in values.items()}
    field = xr.Dataset({**variables, "valid": (DIMS, valid)}, axes, {"frame": "camera", "dt_s": 0.001})
    write_velocity("run7/results/velocity.nc", field)
    grid = VoxelGrid((-2.0, -1.0, 0.0), (0.5, 0.5, 0.25), (5, 7, 9))
    lit = np.zeros(grid.shape, bool)
    lit[4, 6, 2] = True
    volume = SparseVolume.from_mask(grid, lit)
    write_volume("run7/results/volume-a.h5", volume.with_values(np.full(1, 7, np.float32)))
    commands = recipe("Which file for which program", "sh").splitlines()
    assert {Path(shlex.split(line)[3]).suffix for line in commands} == {
        ".vtkhdf",
        ".vti",
        ".csv",
        ".mat",
        ".txt",
        ".nc",
    }
    for line in commands:
        assert main(shlex.split(line)[1:]) == 0, line
    return field


@pytest.mark.full
def test_pandas(run7, capsys):
    exec(recipe("pandas"), {})
    assert "0.5" in capsys.readouterr().out
    assert len(pandas.read_csv("run7/sure.csv")) == 59


@pytest.mark.full
def test_pyvista(run7):
    pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")
    left = {}
    exec(recipe("ParaView and PyVista"), left)
    np.testing.assert_allclose(left["turning"]["vorticity"][:, 2] * 1000, 200.0, rtol=1e-6)  # twice the rotation
    assert Path("run7/arrows.vtp").stat().st_size > 1000
    assert left["measured"].n_points == 60 - 1


@pytest.mark.full
def test_matlab(run7):
    """MATLAB is not here: the variables that its lines name, of the shapes they need."""
    held = scipy.io.loadmat("run7/field.mat", simplify_cells=True)
    lines = recipe("MATLAB and Octave", "matlab")
    named = set(re.findall(r"\bf\.(\w+)", lines))
    assert named == {"units", "meaning", "x", "y", "z", "u", "v", "w", "valid"}
    assert named <= set(held)
    x, y, _ = np.meshgrid(held["x"], held["y"], held["z"])
    np.testing.assert_array_equal(held["u"].reshape(x.shape), -0.1 * y)  # as reader and MATLAB drop the single time
    np.testing.assert_array_equal(held["v"].reshape(x.shape), 0.1 * x)


def test_napari_is_given_mm_and_the_order_z_y_x(run7, monkeypatch):
    """With a stand-in for napari's viewer, which keeps what it is given."""
    given = {}
    viewer = types.SimpleNamespace(
        add_image=lambda image, **options: given.update(image=image, **options),
        add_vectors=lambda vectors, **options: given.update(vectors=vectors),
        camera=types.SimpleNamespace(),
    )
    stand_in = types.SimpleNamespace(Viewer=lambda ndisplay: viewer, run=lambda: given.update(ran=True))
    monkeypatch.setitem(sys.modules, "napari", stand_in)
    exec(recipe("napari"), {})
    place = np.array(np.unravel_index(np.argmax(given["image"]), given["image"].shape))
    bright = place * given["scale"] + given["translate"]
    np.testing.assert_allclose(bright, (1.0, 2.0, -1.0))  # z, y, x in mm
    assert given["vectors"].shape == (59, 2, 3)
    at, velocity = given["vectors"][-1]
    np.testing.assert_allclose((at, velocity), [(1, 2, 2), (0.5, 0.2, -0.2)])
    assert given["ran"]
