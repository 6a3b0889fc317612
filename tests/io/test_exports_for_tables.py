"""Velocity for pandas, MATLAB, VTK's XML images and pivpy: read back as written, units said, signs and places kept."""

import numpy as np
import pandas
import pytest
import scipy.io
import xarray
from exported_fields import DIMS, SHAPE, field, phases

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io import matlab as matlab_files
from plenopiv.io import write_velocity
from plenopiv.io.matlab import write_matlab
from plenopiv.io.pivpy import write_pivpy
from plenopiv.io.table import write_table
from plenopiv.io.vti import write_vti
from plenopiv.io.vtkhdf import write_vtkhdf
from plenopiv.simulation.vtk_image import read_vtk_image

TIMES = 2
NAMES = ("u", "v", "w", "u_std", "v_std", "w_std")


@pytest.fixture
def noisy():
    """The field with digits to the last bit."""
    given = field(TIMES)
    rng = np.random.default_rng(3)
    for name in "uvw":
        given[name] = given[name] + rng.normal(size=given[name].shape)
        given[name].attrs["units"] = "m s-1"
    return given


def test_pandas_reads_the_same_numbers(tmp_path, noisy):
    write_table(tmp_path / "vectors.csv", noisy)
    table = pandas.read_csv(tmp_path / "vectors.csv")
    assert list(table.columns[:5]) == ["time_s", "x_mm", "y_mm", "z_mm", "u_m_s"]
    assert len(table) == noisy.u.size
    assert (table.x_mm.diff()[1:5] > 0).all()  # x is the fastest
    back = table.set_index(["time_s", "z_mm", "y_mm", "x_mm"])
    for name in NAMES:
        np.testing.assert_array_equal(back[f"{name}_m_s"].to_numpy().reshape(noisy.u.shape), noisy[name].values)
    np.testing.assert_array_equal(back.valid.to_numpy().reshape(noisy.u.shape), noisy.valid.values)
    assert table.valid.dtype.kind == "i"
    for axis in "zyx":
        np.testing.assert_array_equal(np.unique(table[f"{axis}_mm"]), noisy[axis].values)


def test_matlab_reads_arrays_as_meshgrid_has_them(tmp_path, noisy):
    write_matlab(tmp_path / "field.mat", noisy)
    held = scipy.io.loadmat(tmp_path / "field.mat", simplify_cells=True)
    raw = scipy.io.loadmat(tmp_path / "field.mat")
    assert raw["x"].shape == (5, 1)
    x, y, z = np.meshgrid(held["x"], held["y"], held["z"])  # as MATLAB's
    assert x.shape == held["w"].shape[:3] == (4, 5, 3)
    for name in NAMES:
        np.testing.assert_array_equal(held[name], noisy[name].transpose("y", "x", "z", "time").values)
    chosen = noisy.sel(x=x[1, 3, 2], y=y[1, 3, 2], z=z[1, 3, 2]).isel(time=1)
    assert held["v"][1, 3, 2, 1] == chosen.v
    np.testing.assert_array_equal(held["valid"], noisy.valid.transpose("y", "x", "z", "time").values)
    assert scipy.io.whosmat(tmp_path / "field.mat")[-3] == ("valid", (4, 5, 3, TIMES), "logical")
    assert (held["units"]["u"], held["units"]["x"], held["units"]["time"]) == ("m s-1", "mm", "s")
    assert "toward the camera" in held["meaning"]["axes"]


def test_phases_are_columns(tmp_path):
    write_table(tmp_path / "vectors.csv", phases())
    table = pandas.read_csv(tmp_path / "vectors.csv")
    w = phases().w.values
    for number, (phase, pairs) in enumerate(((0.0, 3), (120.0, 4), (240.0, 3))):
        chosen = table[table.phase_degree == phase]
        np.testing.assert_array_equal(chosen.w_m_s, w[number].ravel())
        assert set(chosen.pairs) == {pairs}
    write_matlab(tmp_path / "field.mat", phases())
    held = scipy.io.loadmat(tmp_path / "field.mat")
    np.testing.assert_array_equal(held["phase"], [[0.0], [120.0], [240.0]])
    assert held["units"]["phase"][0, 0] == "degree"


def test_a_variable_too_large_for_matlab_s_files_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(matlab_files, "MOST_BYTES", 100)
    with pytest.raises(PlenoPIVError, match=r"hold 2 GB a variable; in MATLAB read velocity\.nc"):
        write_matlab(tmp_path / "field.mat", field())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("time", range(TIMES))
def test_vtk_reads_an_image_in_double_precision(tmp_path, noisy, time):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")
    write_vti(tmp_path / "field.vti", noisy, time)
    mesh = pyvista.read(tmp_path / "field.vti")
    assert mesh.dimensions == SHAPE[::-1]
    np.testing.assert_allclose([mesh.origin, mesh.spacing], [(-3, 2, -1), (2, 0.25, 0.5)])
    of_time = noisy.isel(time=time)
    for array, names in {"velocity": NAMES[:3], "velocity_std": NAMES[3:]}.items():
        expected = np.stack([of_time[name].values.ravel() for name in names], -1)
        np.testing.assert_array_equal(mesh[array], expected)
    np.testing.assert_array_equal(mesh["valid"], of_time.valid.values.ravel())
    assert mesh.point_data.active_vectors_name == "velocity"
    assert mesh.field_data["TimeValue"][0] == float(of_time.time)
    assert "velocity: m s-1" in str(mesh.field_data["units"][0])


def test_a_flow_read_from_an_image_is_the_field(tmp_path):
    given = field()
    given["u"] = given.u.fillna(0.0)
    write_vti(tmp_path / "field.vti", given)
    grid = read_vtk_image(tmp_path / "field.vti", ("velocity",))
    np.testing.assert_array_equal(grid.velocity[..., 2], given.w.values[0])
    np.testing.assert_allclose(grid.first, (-3, 2, -1))


def test_pivpy_s_schema_holds_measured_vectors_and_leaves_w_free(tmp_path, noisy):
    """What pivpy reads: u, v, chc on (y, x, t), 1 for valid. Its own reader: campaigns/pivpy_reader.py."""
    write_pivpy(tmp_path / "plane.nc", noisy, -1.05)
    with xarray.open_dataset(tmp_path / "plane.nc", engine="h5netcdf") as plane:
        assert plane.u.dims == ("y", "x", "t")
        assert "w" not in plane
        given = noisy.sel(z=-1.0).transpose("y", "x", "time")
        for name, there in {"u": "u", "v": "v", "w": "velocity_z", "w_std": "velocity_z_std"}.items():
            np.testing.assert_array_equal(plane[there].values, given[name].values)
            assert plane[there].units == "m s-1"
        assert plane.attrs["z_mm"] == -1.0
        expected = (given.valid == 1) & given.u.notnull()
        np.testing.assert_array_equal(plane.chc.values, expected.values)
        assert plane.chc.sum() == plane.chc.size - TIMES  # the one that no view sees
    write_pivpy(tmp_path / "other.nc", noisy, -0.5)
    with xarray.open_dataset(tmp_path / "other.nc", engine="h5netcdf") as plane:
        assert float(plane.chc.sel(x=1.0, y=2.25).sum()) == 0  # replaced


def test_names_and_texts_of_any_file_can_be_written(tmp_path):
    """Characters that are none of XML, of UTF-8, or of a name in MATLAB; attributes that are no text."""
    given, odd = field(), 'a"<&\n\0\ud800'
    given[odd] = 2 * given.v
    given["_x"] = given.v
    for name, attributes in {"u": {"units": odd, "long_name": odd}, "v": {"units": np.arange(3)}}.items():
        given[name].attrs = attributes
    given.attrs = {"dt_s": np.arange(2), "frame": 3}
    write_table(tmp_path / "a.csv", given)
    write_matlab(tmp_path / "a.mat", given)
    write_vti(tmp_path / "a.vti", given)
    write_pivpy(tmp_path / "a.nc", given, 0.0)
    write_vtkhdf(tmp_path / "a.vtkhdf", given)
    back = read_vtk_image(tmp_path / "a.vti", ("velocity",))
    np.testing.assert_array_equal(back.velocity[..., 1], given.v.values[0])
    assert pandas.read_csv(tmp_path / "a.csv").columns[-1] == "_x_m_s"
    assert "_x" not in scipy.io.loadmat(tmp_path / "a.mat")


def test_floats_of_two_bytes_are_written_as_four(tmp_path, noisy):
    noisy["extra"] = noisy.u.astype(np.float16)
    write_vti(tmp_path / "field.vti", noisy)
    assert b'type="Float32" Name="extra"' in (tmp_path / "field.vti").read_bytes()
    write_matlab(tmp_path / "field.mat", noisy)
    held = scipy.io.loadmat(tmp_path / "field.mat")["extra"]
    np.testing.assert_array_equal(held, noisy.extra.transpose("y", "x", "z", "time").values.astype(np.float32))


@pytest.mark.parametrize("write", [write_vti, write_vtkhdf])
def test_uneven_planes_are_no_image(tmp_path, write):
    uneven = field().assign_coords(z=[-1.0, -0.5, 0.5])
    with pytest.raises(PlenoPIVError, match="not evenly spaced along z"):
        write(tmp_path / "field.any", uneven)
    assert not list(tmp_path.iterdir())


def test_text_says_units_and_the_plane(tmp_path):
    source, plane = tmp_path / "velocity.nc", tmp_path / "plane.txt"
    write_velocity(source, field(TIMES))
    assert main(["export", str(source), str(plane), "--z", "-0.9", "--time", "1"]) == 0
    said = [line for line in plane.read_text().splitlines() if line.startswith("#")]
    assert "x, y in mm, u, v in m/s at z = -1 mm" in said[1]
    assert np.loadtxt(plane).shape == (20, 6)


def test_the_command_writes_each_format(tmp_path, capsys):
    source = tmp_path / "velocity.nc"
    write_velocity(source, field(TIMES))
    for name, *rest in (("a.csv",), ("a.mat",), ("a.vti", "--time", "1"), ("a.nc", "--z", "0"), ("a.vtkhdf",)):
        assert main(["export", str(source), str(tmp_path / name), *rest]) == 0, name
        assert (tmp_path / name).stat().st_size > 100
    assert "a.vti (time 1 of 2, counted from 0)" in capsys.readouterr().out
    assert set(xarray.load_dataset(source, engine="h5netcdf").u.dims) == set(DIMS)
    before = source.read_bytes()
    wrong = {
        ("a.nc",): "pivpy's files hold one plane: choose it with --z",
        ("b.csv", "--z", "0"): ".csv holds all planes; leave --z out",
        ("b.mat", "--time", "0"): ".mat holds all times; leave --time out",
        ("b.vti", "--time", "2"): "time 2: the field has 2, numbered from 0",
        ("velocity.nc", "--z", "0", "--overwrite"): "is what would be read",
        ("b.xls",): ".csv for pandas",
    }
    for (name, *rest), said in wrong.items():
        assert main(["export", str(source), str(tmp_path / name), *rest]) == 2
        line = capsys.readouterr().err
        assert said in line
        assert line.count("\n") == 1
    assert source.read_bytes() == before
    assert not list(tmp_path.glob("b.*"))
