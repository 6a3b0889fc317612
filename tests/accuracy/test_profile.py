"""Errors by depth: each plane has its own, along the axis that has them."""

import numpy as np
import pytest
import xarray as xr

from plenopiv.accuracy import error_by_depth

VOXEL_MM, DT_S = (0.02, 0.02, 0.08), 5e-4
Z = np.array([-1.0, 0.0, 1.0])


def still(points):
    return np.zeros_like(points)


def measured(offsets_voxels):
    """Vectors at rest but for offsets (nz, 3) in voxels, alternately more and less by half."""
    scale = np.array(VOXEL_MM) * 1e-3 / DT_S
    sign = np.where(np.arange(20).reshape(4, 5) % 2, 1.5, 0.5)
    values = np.asarray(offsets_voxels)[:, None, None, :] * sign[None, :, :, None] * scale
    dims = ("time", "z", "y", "x")
    parts = {name: (dims, values[None, ..., k]) for k, name in enumerate("uvw")}
    parts["valid"] = (dims, np.ones((1, 3, 4, 5), np.int8))
    return xr.Dataset(parts, {"time": [0.0], "z": Z, "y": np.arange(4.0), "x": np.arange(5.0)})


@pytest.mark.parametrize("axis", range(3))
def test_each_axis_and_plane_has_its_own_error(axis):
    offsets = np.zeros((3, 3))
    offsets[:, axis] = (0.1, -0.2, 0.4)
    profile = error_by_depth(measured(offsets), still, VOXEL_MM, DT_S)
    expected = np.zeros((3, 3))
    expected[axis] = (0.1, -0.2, 0.4)
    np.testing.assert_allclose(profile.bias, expected, atol=1e-12)
    np.testing.assert_allclose(profile.rms, np.abs(expected) * np.sqrt((1.5**2 + 0.5**2) / 2), atol=1e-12)
    assert profile.vectors.tolist() == [20, 20, 20]
    assert profile.z_mm.tolist() == Z.tolist()


def test_the_truth_is_asked_where_the_vectors_are():
    def shear(points):
        return np.stack([3.0 * points[:, 2], 5.0 * points[:, 0], 7.0 * points[:, 1]], -1)

    field = measured(np.zeros((3, 3)))
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    for name, values in (("u", 3.0 * z), ("v", 5.0 * x), ("w", 7.0 * y)):
        field[name] = field[name].dims, values[None]
    np.testing.assert_allclose(error_by_depth(field, shear, VOXEL_MM, DT_S).rms, 0, atol=1e-9)


def test_replaced_and_gross_vectors_are_left_out():
    field = measured(np.full((3, 3), 0.1))
    field["valid"][0, 0] = 0
    field["w"][0, 1, 0, 0] = 1e3
    profile = error_by_depth(field, still, VOXEL_MM, DT_S)
    assert profile.vectors.tolist() == [0, 19, 20]
    assert np.isnan(profile.rms[:, 0]).all()
    assert (profile.rms[:, 1] < 0.2).all()
