"""Flows from netCDF files: units, axes, what cannot be used."""

import numpy as np
import pytest
from simulation.flow_files import dataset, grid, linear, write

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation import netcdf_grid
from plenopiv.simulation.flows import describe, flow


@pytest.fixture(autouse=True)
def without_child(request, monkeypatch):
    """A child process tries each file, some tenths of a second; tests of damaged ones have it."""
    if "none" not in request.node.name:
        monkeypatch.setattr(netcdf_grid, "damage", lambda path, netcdf: "")


MIDDLE = np.array([[-0.1, 1.3, 2.2], [0.4, 2.9, 2.4]])


@pytest.mark.parametrize(
    ("length", "per_mm", "speed", "per_m_s"),
    [("mm", 1.0, "m/s", 1.0), ("m", 1e-3, "mm s-1", 1e3), ("cm", 0.1, "cm.s-1", 1e2), ("um", 1e3, "m s**-1", 1.0),
     ("\N{GREEK SMALL LETTER MU}m", 1e3, "m/s", 1.0)],
)  # fmt: skip
def test_units_are_read(tmp_path, length, per_mm, speed, per_m_s):
    path = write(dataset(length, speed, per_mm, per_m_s), tmp_path / "flow.nc")
    assert flow("file", path=path)(MIDDLE) == pytest.approx(linear(MIDDLE))


def test_axes_in_any_order_and_direction(tmp_path):
    data = dataset().transpose("x", "z", "y").isel(z=slice(None, None, -1), x=slice(None, None, -1))
    assert flow("file", path=write(data, tmp_path / "flow.nc"))(MIDDLE) == pytest.approx(linear(MIDDLE))


def test_u_that_grows_with_z_moves_near_particles_more(tmp_path):
    velocity = flow("file", path=write(dataset(), tmp_path / "flow.nc"))
    far, near = velocity(np.array([[0.0, 1.0, 2.0], [0.0, 1.0, 2.5]]))
    assert near - far == pytest.approx([0.05, 0.0, 0.0])


def test_at_mm_is_the_point_that_the_camera_looks_at_and_speed_a_factor(tmp_path):
    path = write(dataset(), tmp_path / "flow.nc")
    moved = flow("file", path=path, at_mm=[0.1, 1.7, 2.3], speed=-2.0)
    offset = np.array([[0.1, -0.2, 0.05]])
    assert moved(offset) == pytest.approx(-2.0 * linear(offset + np.array([0.1, 1.7, 2.3])))


def test_packed_integers_and_several_times(tmp_path):
    import xarray

    data = xarray.concat([dataset(), dataset(per_m_s=2.0)], "time")
    packed = {"dtype": "int16", "scale_factor": 1e-4, "_FillValue": -32768}
    data.to_netcdf(tmp_path / "two.nc", engine="h5netcdf", encoding=dict.fromkeys("uvw", packed))
    path = str(tmp_path / "two.nc")
    assert flow("file", path=path, time=1)(MIDDLE) == pytest.approx(2.0 * linear(MIDDLE), abs=1e-4)
    with pytest.raises(PlenoPIVError, match="holds 2 times; give time"):
        flow("file", path=path)
    with pytest.raises(PlenoPIVError, match="time = 2, it holds 0 to 1"):
        flow("file", path=path, time=2)


def test_other_names(tmp_path):
    path = write(dataset().rename(u="Vx", v="Vy", w="Vz"), tmp_path / "flow.nc")
    assert flow("file", path=path, variables=["Vx", "Vy", "Vz"])(MIDDLE) == pytest.approx(linear(MIDDLE))
    with pytest.raises(PlenoPIVError, match="no variable 'u'; it holds Vx, Vy, Vz; name yours with variables"):
        flow("file", path=path)


def test_a_file_without_units(tmp_path):
    path = write(dataset(length=None), tmp_path / "flow.nc")
    with pytest.raises(PlenoPIVError, match=r"flow\.nc: states no units for x; give length_unit, one of mm"):
        flow("file", path=path)
    assert flow("file", path=path, length_unit="mm")(MIDDLE) == pytest.approx(linear(MIDDLE))
    path = write(dataset(speed=None, per_m_s=1e3), tmp_path / "flow.nc")
    with pytest.raises(PlenoPIVError, match="states no units for u; give velocity_unit"):
        flow("file", path=path)
    assert flow("file", path=path, velocity_unit="mm/s")(MIDDLE) == pytest.approx(linear(MIDDLE))


def test_units_that_contradict_or_are_unknown(tmp_path):
    path = write(dataset(), tmp_path / "flow.nc")
    with pytest.raises(PlenoPIVError, match="x is in 'mm' there, but length_unit = 'm'"):
        flow("file", path=path, length_unit="m")
    with pytest.raises(PlenoPIVError, match="u is in 'furlong/day', which is not known; use one of m/s"):
        flow("file", path=write(dataset(speed="furlong/day"), tmp_path / "odd.nc"))


def uneven(data):
    return data.assign_coords(y=("y", data.y.values**1.05, {"units": "mm"}))


def holed(data):
    data.w.values[0, 0, 0] = np.nan
    return data


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (uneven, "y is not evenly spaced"),
        (holed, "1 of 336 grid points are NaN or infinite"),
        (lambda d: d.drop_vars("z"), "has no coordinate z"),
        (lambda d: d.isel(z=0, drop=True), "u has dimensions"),
        (lambda d: d.isel(z=[0]), "one point along z"),
        (lambda d: d.isel(x=slice(3)), "3 points along x; splines need 4 or more"),
    ],
)
def test_what_cannot_be_used_is_one_line(tmp_path, change, said):
    path = write(change(dataset()), tmp_path / "flow.nc")
    with pytest.raises(PlenoPIVError, match=said) as told:
        flow("file", path=path)
    assert str(told.value).startswith(f"flow: {path}: ")
    assert "\n" not in str(told.value)


def test_files_that_are_none(tmp_path):
    (tmp_path / "text.nc").write_text("no netCDF")
    (tmp_path / "flow.csv").write_text("1,2,3")
    for name, said in {
        "text.nc": "is no netCDF4 file",
        "flow.csv": "read are netCDF4",
        "none.nc": "no such file",
    }.items():
        with pytest.raises(PlenoPIVError, match=said):
            flow("file", path=str(tmp_path / name))


def test_wrong_parameters(tmp_path):
    path = write(dataset(), tmp_path / "flow.nc")
    for parameters, said in [
        ({"outside": "wrap"}, "outside = 'wrap'; give one of error, zero, periodic"),
        ({"at_mm": [0.0, 1.0]}, "at_mm = .*; give x, y, z in mm"),
        ({"speed": float("nan")}, "speed = nan"),
        ({"variables": ["u", "v"]}, "give the three names"),
    ]:
        with pytest.raises(PlenoPIVError, match=said):
            flow("file", path=path, **parameters)


def test_outside_and_the_record(tmp_path):
    path = write(dataset(), tmp_path / "flow.nc")
    with pytest.raises(PlenoPIVError, match=r"x = -1\.100 to -1\.100 mm"):
        flow("file", path=path)(np.array([[-1.1, 1.0, 2.1]]))
    still = flow("file", path=path, outside="zero")
    assert still(np.array([[-1.1, 1.0, 2.1]])) == pytest.approx(0.0)
    name, parameters = describe(still)
    assert (name, parameters["path"], parameters["outside"]) == ("file", path, "zero")
    assert flow(name, **parameters)(grid()[0, 0]) == pytest.approx(linear(grid()[0, 0]))
