"""Units, coordinates and attributes of the velocity field."""

import numpy as np
import pytest
import xarray as xr

from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError
from plenopiv.velocity import replaced, replaced_share, vectors_inside_body, velocity_dataset
from plenopiv.volume import VoxelGrid

GRID = VoxelGrid.covering((-4.0, 4.0), (-3.0, 3.0), (-2.0, 2.0), (0.02, 0.02, 0.08))


@pytest.fixture
def field():
    shape = (2, 3, 4)
    displacement = np.arange(72.0).reshape(3, *shape)
    valid = np.ones(shape, bool)
    valid[1, 2, 3] = False
    z, y, x = 7.5 + 8 * np.arange(2), 31.5 + 32 * np.arange(3), 31.5 + 32 * np.arange(4)
    ratio, std = np.full(shape, 2, np.float32), 0.01 * (1 + displacement)
    return DisplacementField(z, y, x, displacement, displacement + 1, valid, ratio, std)


def test_one_voxel_per_frame_in_metres_per_second(field):
    ds = velocity_dataset(field, GRID, 5e-4)
    for k, (name, voxel_m) in enumerate((("u", 2e-5), ("v", 2e-5), ("w", 8e-5))):
        np.testing.assert_allclose(ds[name][0], field.displacement[k] * voxel_m / 5e-4)
        np.testing.assert_allclose(ds[f"{name}_raw"][0], field.raw[k] * voxel_m / 5e-4)
        np.testing.assert_allclose(ds[f"{name}_std"][0], field.std[k] * voxel_m / 5e-4)
        assert ds[f"{name}_std"].attrs["units"] == "m s-1"
        assert ds[name].attrs["ancillary_variables"].split() == [f"{name}_std", "valid"]
        assert ds[name].dims == ("time", "z", "y", "x")
        assert ds[name].attrs["units"] == "m s-1"


def test_coordinates_are_window_centres_in_mm(field):
    ds = velocity_dataset(field, GRID, 5e-4, 0.25)
    # voxel 0 spans -4 to -3.98 mm: index 31.5 is 32 voxels from the face
    np.testing.assert_allclose(ds.x[:2], [-4 + 32 * 0.02, -4 + 64 * 0.02])
    np.testing.assert_allclose(ds.z[0], -2 + 8 * 0.08)
    assert ds.time.values.tolist() == [0.25]
    assert {ds[a].attrs["units"] for a in "xyz"} == {"mm"}


def test_flags_and_conventions_survive_the_file(field, tmp_path):
    path = tmp_path / "velocity.nc"
    velocity_dataset(field, GRID, 5e-4, 0.25).to_netcdf(path, engine="h5netcdf")
    with xr.open_dataset(path, engine="h5netcdf") as ds:
        assert ds.valid.dtype == np.int8
        assert ds.valid.values.sum() == 23
        assert ds.valid.attrs["flag_meanings"] == "replaced measured"
        assert ds.attrs["Conventions"].startswith("CF-1.")
        assert ds.attrs["title"] == "Volumetric velocity"
        assert ds.time.values.tolist() == [0.25]
        assert ds.peak_ratio.dtype == np.float32


@pytest.mark.parametrize("dt_s", [0.0, -1.0, float("nan")])
def test_time_between_frames_must_be_positive(field, dt_s):
    with pytest.raises(PlenoPIVError, match="dt_s"):
        velocity_dataset(field, GRID, dt_s)


def test_vectors_in_a_body_are_counted_and_not_called_replaced():
    """Of six vectors three lie in a body, where nothing is measured, and one of the others was replaced."""
    values = {
        "u": [np.nan, 1.0, np.nan, 1.0, 1.0, np.nan],
        "valid": np.array([0, 1, 0, 0, 1, 0], np.int8),
        "inside_body": np.array([1, 0, 1, 0, 0, 1], np.int8),
    }
    field = xr.Dataset({name: ("x", column) for name, column in values.items()})
    assert vectors_inside_body(field) == 3
    assert vectors_inside_body(field.isel(x=slice(0, 3))) == 2
    assert vectors_inside_body(field.drop_vars("inside_body")) is None
    assert replaced(field).values.tolist() == [False, False, False, True, False, False]
    assert replaced_share(field) == pytest.approx(1 / 3)
    assert replaced_share(field.isel(x=[0, 2])) == 0.0  # all of it inside
