"""Velocity and volumes for other programs: read back with VTK itself, signs and places as in velocity.nc."""

import itertools

import h5py
import numpy as np
import pytest
from exported_fields import SHAPE, field, phases

from plenopiv.cli import main
from plenopiv.errors import PlenoPIVError
from plenopiv.io import write_velocity
from plenopiv.io.openpiv import as_openpiv, write_openpiv
from plenopiv.io.vtkhdf import write_volume_vtkhdf, write_vtkhdf
from plenopiv.volume import SparseVolume, VoxelGrid


@pytest.fixture(scope="module")
def pyvista():
    return pytest.importorskip("pyvista", reason="needs PyVista: part of requirements-dev.txt")


def test_vtk_reads_the_velocity_back(tmp_path, pyvista):
    write_vtkhdf(tmp_path / "field.vtkhdf", field())
    mesh = pyvista.read(tmp_path / "field.vtkhdf")
    assert mesh.dimensions == SHAPE[::-1]
    np.testing.assert_allclose([mesh.origin, mesh.spacing], [(-3, 2, -1), (2, 0.25, 0.5)])
    expected = mesh.points * (1, 10, 100)
    seen = np.isfinite(mesh["velocity"]).all(1)
    assert seen.sum() == seen.size - 1
    np.testing.assert_allclose(mesh["velocity"][seen], expected[seen], rtol=1e-6)
    np.testing.assert_array_equal(mesh["velocity_std"], np.tile([0.0, 0.0, 1.0], (seen.size, 1)))
    replaced = mesh.points[mesh["valid"] == 0]
    np.testing.assert_allclose(replaced, [[1.0, 2.25, -0.5]])


def test_vtk_reads_several_times(tmp_path, pyvista):
    write_vtkhdf(tmp_path / "field.vtkhdf", field(times=3))
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(tmp_path / "field.vtkhdf"))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 3
    for number, time in enumerate((0.5, 1.5, 2.5)):
        reader.SetStep(number)
        reader.Update()
        mesh = pyvista.wrap(reader.GetOutput())
        assert reader.GetTimeValue() == time
        np.testing.assert_allclose(mesh["velocity"][:, 2], 100 * mesh.points[:, 2] + 1000 * number, rtol=1e-6)
        assert (mesh["valid"] == 0).sum() == 1


def test_steps_ascend_and_are_phases_where_there_are_some(tmp_path, pyvista):
    """VTK searches steps by their value: of those that fall it gives another's field."""
    falling = field(3).isel(time=[2, 0, 1])
    for given, values in ((phases(), [0.0, 120.0, 240.0]), (falling, [0.5, 1.5, 2.5])):
        write_vtkhdf(tmp_path / "field.vtkhdf", given)
        reader = pyvista.get_reader(tmp_path / "field.vtkhdf").reader
        reader.UpdateInformation()
        for number, value in enumerate(values):
            reader.UpdateTimeStep(value)
            mesh = pyvista.wrap(reader.GetOutput())
            assert reader.GetTimeValue() == value
            np.testing.assert_allclose(mesh["velocity"][:, 2], 100 * mesh.points[:, 2] + 1000 * number, rtol=1e-6)
    with pytest.raises(PlenoPIVError, match=r"time = 0\.25 is there twice, .* export \.csv or \.mat"):
        write_vtkhdf(tmp_path / "other.vtkhdf", phases().drop_vars("phase"))
    assert not (tmp_path / "other.vtkhdf").exists()


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("shape", list(itertools.product((1, 3), (1, 4), (1, 5))))
def test_vtk_reads_axes_of_one_vector(tmp_path, pyvista, shape, times):
    """Of such axes arrays have none in the file: VTK otherwise refuses them."""
    given = field(times).isel({axis: slice(-n, None) for axis, n in zip("zyx", shape, strict=True)})
    write_vtkhdf(tmp_path / "field.vtkhdf", given)
    reader = pyvista.get_reader(tmp_path / "field.vtkhdf").reader
    for number in range(times):
        reader.SetStep(number)
        reader.Update()
        mesh = pyvista.wrap(reader.GetOutput())
        assert mesh.dimensions == shape[::-1]
        expected = [given[name].values[number].ravel() for name in "uvw"]
        np.testing.assert_allclose(mesh["velocity"].T, expected, rtol=1e-6)
        np.testing.assert_array_equal(mesh["valid"], given.valid.values[number].ravel())


@pytest.mark.parametrize("shape", list(itertools.product((1, 9), (1, 6), (1, 7))))
def test_vtk_reads_volumes_of_one_voxel_along_an_axis(tmp_path, pyvista, shape):
    volume = SparseVolume.from_mask(VoxelGrid((1.0, -2.0, 0.5), (0.1, 0.2, 0.4), shape), np.ones(shape, bool))
    volume = volume.with_values(np.arange(1, volume.column.size + 1, dtype=np.float32))
    write_volume_vtkhdf(tmp_path / "volume.vtkhdf", volume)
    mesh = pyvista.read(tmp_path / "volume.vtkhdf")
    np.testing.assert_array_equal(mesh["intensity"].reshape(shape), volume.dense().values)


def test_vtk_reads_a_volume(tmp_path, pyvista):
    grid = VoxelGrid((1.0, -2.0, 0.5), (0.1, 0.2, 0.4), (19, 6, 7))
    volume = SparseVolume.from_mask(grid, np.random.default_rng(0).random(grid.shape) < 0.2)
    volume = volume.with_values(np.arange(1, volume.column.size + 1, dtype=np.float32))
    write_volume_vtkhdf(tmp_path / "volume.vtkhdf", volume)
    mesh = pyvista.read(tmp_path / "volume.vtkhdf")
    np.testing.assert_array_equal(mesh["intensity"].reshape(grid.shape), volume.dense().values)
    brightest = mesh.points[np.argmax(mesh["intensity"])]
    row = np.searchsorted(volume.row_start, volume.column.size - 1, side="right") - 1
    place = volume.column[-1], row % 6, row // 6
    np.testing.assert_allclose(brightest, np.array(grid.first_mm) + np.array(grid.voxel_mm) * place, rtol=1e-5)


def test_a_vtkhdf_file_says_what_the_format_demands(tmp_path):
    write_vtkhdf(tmp_path / "field.vtkhdf", field())
    with h5py.File(tmp_path / "field.vtkhdf") as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"ImageData"
        assert list(root.attrs["WholeExtent"]) == [0, 4, 0, 3, 0, 2]
        assert root["PointData/velocity"].shape == (*SHAPE, 3)
    write_vtkhdf(tmp_path / "field.vtkhdf", field(times=2))
    with h5py.File(tmp_path / "field.vtkhdf") as file:
        root = file["VTKHDF"]
        assert root["PointData/velocity"].shape == (2, *SHAPE, 3)
        assert root["Steps"].attrs["NSteps"] == 2


def test_openpiv_s_rows_come_from_above_and_v_is_upward(tmp_path):
    found = as_openpiv(field(), -0.55)
    assert found.u.dims == ("y", "x")
    assert found.y[0] > found.y[-1]
    assert found.x[0] < found.x[-1]
    np.testing.assert_allclose(found.v, (10 * found.y + 0 * found.x))
    assert (found.flags == 2).sum() == 1
    assert found.flags.sel(x=1.0, y=2.25) == 2
    write_openpiv(tmp_path / "plane.txt", field(), -1.0)
    x, y, u, _, flags, mask = np.loadtxt(tmp_path / "plane.txt", unpack=True)
    assert (mask == 1).sum() == 1
    assert (x[mask == 1], y[mask == 1]) == (-3.0, 2.0)
    np.testing.assert_allclose(u[mask == 0], x[mask == 0])
    assert (flags == 0).all()


def test_planes_and_times_that_are_not_there():
    with pytest.raises(PlenoPIVError, match="z = 3 mm: vectors lie from z = -1 to 0 mm"):
        as_openpiv(field(), 3.0)
    with pytest.raises(PlenoPIVError, match="time 1: the field has 1"):
        as_openpiv(field(), -1.0, time=1)


def test_the_command(tmp_path, capsys):
    source, mesh, plane = (tmp_path / name for name in ("velocity.nc", "field.vtkhdf", "plane.txt"))
    write_velocity(source, field())
    assert main(["export", str(source), str(mesh)]) == 0
    assert main(["export", str(source), str(plane), "--z", "-0.5"]) == 0
    assert plane.read_text().startswith("# x\ty\tu\tv\tflags\tmask\n")
    before, _ = mesh.read_bytes(), capsys.readouterr()
    wrong = {
        ("field.vtkhdf",): "is there already; use --overwrite",
        ("field.vtk",): "the ending names the format",
        ("other.txt",): "choose it with --z",
        ("other.vtkhdf", "--z", "1"): "leave --z out",
    }
    for (name, *rest), said in wrong.items():
        assert main(["export", str(source), str(tmp_path / name), *rest]) == 2
        line = capsys.readouterr().err
        assert said in line
        assert line.count("\n") == 1
    assert main(["export", str(tmp_path / "none.nc"), str(tmp_path / "other.vtkhdf")]) == 2
    assert mesh.read_bytes() == before
    assert not (tmp_path / "other.vtkhdf").exists()


def test_the_command_takes_a_results_folder(tmp_path, capsys):
    results = tmp_path / "results"
    results.mkdir()
    assert main(["export", str(results), str(tmp_path / "a.csv")]) == 2
    assert f"{results / 'velocity.nc'}: no such file" in capsys.readouterr().err
    write_velocity(results / "velocity.nc", field())
    for source, name in ((results, "a.csv"), (results / "velocity.nc", "b.csv")):
        assert main(["export", str(source), str(tmp_path / name)]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
