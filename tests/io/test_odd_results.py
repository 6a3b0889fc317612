"""Results that are none: export and info end with one line, and nothing else on stderr, and write nothing."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io import read_velocity, write_velocity
from plenopiv.io.vtkhdf import write_vtkhdf

DIMS = ("time", "z", "y", "x")


@pytest.fixture
def field():
    rng = np.random.default_rng(3)
    shape = (1, 3, 4, 5)
    variables = {name: (DIMS, rng.normal(size=shape)) for name in "uvw"}
    variables["valid"] = (DIMS, np.ones(shape, np.int8))
    axes = {"time": [0.00025], "z": np.arange(3.0), "y": np.arange(4.0), "x": np.arange(5.0)}
    return xr.Dataset(variables, axes, {"Conventions": "CF-1.11"})


CHANGES = {
    "dimensions": (lambda f: f.transpose("x", "y", "z", "time"), "u has dimensions ('x', 'y', 'z', 'time')"),
    "one other": (lambda f: f.assign(w=f.w.isel(z=0, drop=True)), "w has dimensions"),
    "text": (lambda f: f.assign(v=(DIMS, f.v.values.astype(str))), "v holds"),
    "empty": (lambda f: f.isel(x=slice(0)), "u holds no vectors (1, 3, 4, 0)"),
    "no axis": (lambda f: f.drop_vars("z"), "has no coordinate z of numbers"),
    "text axis": (lambda f: f.assign_coords(x=list("abcde")), "has no coordinate x of numbers"),
    "NaN axis": (lambda f: f.assign_coords(y=[0.0, 1.0, np.nan, 2.0]), "coordinate y is not finite and rising"),
    "twice": (lambda f: f.assign_coords(x=[0.0, 1.0, 1.0, 2.0, 3.0]), "coordinate x is not finite and rising"),
}


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        *((kind, ["info"]) for kind in CHANGES),
        ("twice", ["export", "out.vtkhdf"]),
        ("twice", ["export", "out.txt", "--z", "1"]),
    ],
)
def test_a_file_that_is_no_field(tmp_path, field, capsys, kind, command):
    change, said = CHANGES[kind]
    path = tmp_path / "velocity.nc"
    change(field).to_netcdf(path, engine="h5netcdf")
    name, *rest = command
    out = [str(tmp_path / rest[0]), *rest[1:]] if rest else []
    assert main([name, str(path), *out]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"plenopiv: error: {path}: ")
    assert said in error
    assert error.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["velocity.nc"]


def test_attributes_that_cannot_be_decoded(tmp_path, field):
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    with h5py.File(path, "r+") as file:
        file["u"].attrs["scale_factor"] = "ten"
    with pytest.raises(PlenoPIVError, match=r"velocity\.nc: is no velocity file or is damaged"):
        read_velocity(path)


@pytest.mark.parametrize("name", ["v", "valid"])
def test_variables_that_differ_in_length(tmp_path, field, name):
    """xarray opens such a file, and raises when it is used."""
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    with h5py.File(path, "r+") as file:
        values, attributes = file[name][()], dict(file[name].attrs)
        del file[name]
        made = file.create_dataset(name, data=np.resize(values, (1, 5, 4, 5)).astype(values.dtype))
        for key, value in attributes.items():
            made.attrs[key] = value
    with pytest.raises(PlenoPIVError, match=r"velocity\.nc: is no velocity file or is damaged \(.* values along z, "):
        read_velocity(path)


def test_a_calendar_that_is_none_changes_nothing(tmp_path, field):
    """Time is in s, a number, whatever its units pretend."""
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    with h5py.File(path, "r+") as file:
        file["time"].attrs["units"] = "days since 99999-99-99"
    assert read_velocity(path).time.values.tolist() == [0.00025]


def test_what_single_precision_cannot_hold_is_infinite_without_a_word(tmp_path, field, recwarn):
    field.u.values[0, 0, 0, 0] = 1e300
    field["note"] = (DIMS, np.full(field.u.shape, "a"))
    write_vtkhdf(tmp_path / "out.vtkhdf", field)
    assert not recwarn.list
    with h5py.File(tmp_path / "out.vtkhdf") as file:
        points = file["VTKHDF/PointData"]
        assert set(points) == {"velocity", "valid"}
        assert points["velocity"][0, 0, 0, 0] == np.inf


@pytest.mark.full
@pytest.mark.parametrize("cut", [100, 6000])
def test_a_truncated_file_leaves_stderr_clean(tmp_path, field, cut):
    """In a process of its own: what objects say that cannot be closed, Python prints when it ends."""
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    content = path.read_bytes()
    path.write_bytes(content[:cut])
    command = [sys.executable, "-c", "import sys; from plenopiv.cli import main; sys.exit(main())", "info", str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"plenopiv: error: {path}: is no velocity file or is damaged")
    assert ended.stderr.count("\n") == 1
