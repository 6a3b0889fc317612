"""Flow files that are damaged or hostile: one line, at once, without the memory that they ask for."""

import lzma
import resource
import time
import warnings
import zlib

import numpy as np
import pytest
from simulation.flow_files import dataset, write
from simulation.test_vtk_image import UNITS, legacy, vti

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import flow


def refused(path, **parameters):
    """What is said of a file; within seconds, and no more than 300 MB."""
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    with warnings.catch_warnings(record=True) as warned, pytest.raises(PlenoPIVError) as told:
        flow("file", path=str(path), **parameters)
    assert not warned
    assert time.perf_counter() - began < 8
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000
    message = str(told.value)
    assert message.startswith(f"flow: {path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"FieldData 1\nnumber2 1 336", b"FieldData 1\nnumber2 1 -336", "states an array of -336 x 1 numbers"),
        (b"FieldData 1\nnumber2 1", b"FieldData 1\nnumber2 -1", "states an array of 336 x -1 numbers"),
        (b"FieldData 1\n", b"FieldData 99999999999\n", "is no VTK image or is damaged"),
        (b"number2 1 336", b"number2 99999 9999999999", "states an array of 9999999999 x 99999"),
        (b"DIMENSIONS 8 7 6", b"DIMENSIONS 8 -7 -6", "holds 8 x -7 x -6 points"),
        (b"DIMENSIONS 8 7 6", b"DIMENSIONS 80000 70000 60000", "holds 80000 x 70000 x 60000 points"),
        (b"SPACING 0.25", b"SPACING 0", "spacings must be positive"),
        (b"SPACING 0.25", b"SPACING nan", "spacings must be positive"),
        (b"ORIGIN -1.0", b"ORIGIN 1e999", "all of them finite"),
        (b"\nPOINT_DATA ", b"\n" + 200_000 * b" " + b"\nPOINT_DATA -", "states an array of -336 x 1"),
        (b"SCALARS", 200_000 * b" " + b"SCALARS number\nTENSORS", "is no VTK image or is damaged"),
        (b"DATASET", 200_000 * b"\n" + b"POLYDATA", "holds POLYDATA, which is not read"),
    ],
)
@pytest.mark.parametrize("binary", [True, False])
def test_a_legacy_file(tmp_path, old, new, said, binary):
    path = tmp_path / "flow.vtk"
    legacy(path, binary)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    assert said in refused(path, **UNITS)


def test_two_hundred_kilobytes_of_blanks_within_a_file_that_is_good(tmp_path):
    path = tmp_path / "flow.vtk"
    legacy(path, binary=False)
    path.write_bytes(path.read_bytes().replace(b"\n\nPOINT_DATA", b"\n" + 200_000 * b" " + b"\n  POINT_DATA"))
    began = time.perf_counter()
    flow("file", path=str(path), **UNITS)
    assert time.perf_counter() - began < 5


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b'version="1.0"', b'version="1.0" encoding="ebcdic-sorbian"', "is no VTK image or is damaged"),
        (b'"ascii">0.2 ', b'"ascii">1e300 ', "1e+300 m/s is no velocity of a fluid; is its unit right?"),
        (b'"ascii">0.2 ', b'"ascii">fast ', "is no VTK image or is damaged"),
        (b'WholeExtent="2 9', b'WholeExtent="2 999999999', "wanted some along x, y and z"),
        (b'NumberOfComponents="3"', b'NumberOfComponents="-3"', "states arrays of -3 components"),
        (b'NumberOfComponents="3"', b'NumberOfComponents="0"', "states arrays of 0 components"),
        (b'Spacing="0.25', b'Spacing="-0.25', "spacings must be positive"),
        (b"<PointData>", b"<a>" * 20_000 + b"<PointData>", "is no VTK image or is damaged"),
    ],
)
def test_an_xml_file(tmp_path, old, new, said):
    path = tmp_path / "flow.vti"
    vti(path)
    content = path.read_bytes().replace(b'Piece Extent="2 9', b'Piece Extent="2 999999999') if b"9999" in new else None
    content = content or path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    assert said in refused(path, **UNITS)


@pytest.mark.parametrize(
    "compressor", ["vtkZLibDataCompressor", pytest.param("vtkLZMADataCompressor", marks=pytest.mark.full)]
)
def test_packed_data_that_are_more_than_the_points_are_not_unpacked(tmp_path, compressor):
    path = tmp_path / "flow.vti"
    vti(path, form="raw", compressor=compressor)
    content = path.read_bytes()
    packer = zlib.compressobj() if "ZLib" in compressor else lzma.LZMACompressor(preset=0)
    block = bytes(10_000_000)
    packed = b"".join([packer.compress(block) for _ in range(35)] + [packer.flush()])
    head = np.array([1, 350_000_000, 0, len(packed)], "<u4").tobytes()
    begin = content.index(b">_") + 2
    path.write_bytes(content[:begin] + head + packed + b"</AppendedData></VTKFile>")
    assert "its packed data are more than its points" in refused(path, **UNITS)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"velocity_unit": 0}, "velocity_unit = 0; give a unit as text"),
        ({"length_unit": ["mm"]}, "length_unit = "),
        ({"variables": [1, 2, 3]}, "variables = (1, 2, 3); give names"),
        ({"variables": [["u"], ["v"], ["w"]]}, "variables = "),
        ({"variables": 3}, "variables = 3"),
        ({"time": "first"}, "time = 'first'; give its number"),
        ({"time": True}, "time = True"),
        ({"at_mm": 3.0}, "at_mm = 3.0; give x, y, z"),
        ({"at_mm": ["0", "0", "0"]}, "at_mm = "),
        ({"at_mm": [1e30, 0.0, 0.0]}, "at_mm = "),
        ({"speed": "fast"}, "speed = 'fast'"),
        ({"speed": 1e30}, "speed = 1e+30"),
        ({"outside": ["zero"]}, "outside = "),
        ({"path": 7}, "path = 7 is no file name"),
        ({"path": "a\0b"}, "path = 'a\\x00b' is no file name"),
    ],
)
def test_parameters_of_other_types(tmp_path, parameters, said):
    given = {"path": write(dataset(), tmp_path / "flow.nc")} | parameters
    with pytest.raises(PlenoPIVError) as told:
        flow("file", **given)
    assert said in str(told.value)
    assert len(str(told.value)) < 300


def of_text(data):
    return data.assign(u=(data.u.dims, data.u.values.astype(str), data.u.attrs))


def far_away(data):
    return data.assign_coords(x=("x", data.x.values * 1e30, {"units": "mm"}))


def undefined(data):
    return data.assign_coords(x=("x", data.x.values * np.nan, {"units": "mm"}))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (of_text, "u holds"),
        (far_away, "x is not finite, or beyond all lengths"),
        (undefined, "x is not finite, or beyond all lengths"),
        (lambda d: d.assign_coords(x=("x", ["a"] * 8, {"units": "mm"})), "its coordinate x is no row of numbers"),
        (lambda d: d.assign_coords(x=("x", np.zeros(8), {"units": "mm"})), "x is not evenly spaced"),
        (lambda d: d.assign(u=d.u * 1e300), "m/s is no velocity of a fluid"),
    ],
)
def test_a_netcdf_file_whose_values_are_none(tmp_path, change, said):
    changed = change(dataset())
    for name in "uvw":
        changed[name].attrs["units"] = "m/s"
    path = write(changed, tmp_path / "flow.nc")
    assert said in refused(path)


def test_a_seeding_beyond_memory_is_refused():
    from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
    from plenopiv.lattice import Lattice
    from plenopiv.sensor import Sensor
    from plenopiv.simulation.particles import seed_box

    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(280, 224, 0.0055))
    box = ((-5e4, 5e4), (-5e4, 5e4), (-1.0, 1.0))
    with pytest.raises(PlenoPIVError, match=r"1\.95e\+12 particles in 1e\+05 x 1e\+05 x 2 mm are too many"):
        seed_box(camera, box, 1.0, np.random.default_rng(0), electrons=1.0)
