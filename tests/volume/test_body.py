"""Bodies in the flow: what lies in a closed surface, and files that hold none."""

import numpy as np
import pytest
import trimesh

from plenopiv.body import Body, read_body
from plenopiv.errors import PlenoPIVError


def body_of(mesh):
    return Body(np.asarray(mesh.triangles, float))


def places(*axes):
    """x, y, z of every place, (nz, ny, nx) each."""
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return x, y, z


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_box_far_out_along_each_axis_is_found_there(axis):
    centre = np.zeros(3)
    centre[axis] = 2.0
    x = np.array([-2.0, 0.03, 1.8, 2.0, 2.2]) if axis == 0 else np.array([-2.0, 0.03, 2.1])
    y = np.array([-2.0, 0.04, 1.8, 2.0, 2.2]) if axis == 1 else np.array([-2.0, 0.04, 2.1])
    z = np.array([-2.0, 0.05, 1.8, 2.0, 2.2]) if axis == 2 else np.array([-2.0, 0.05, 2.1])
    mesh = trimesh.creation.box(extents=(1.0, 0.8, 0.6), transform=trimesh.transformations.translation_matrix(centre))
    found = body_of(mesh).holds(x, y, z)
    assert found.shape == (z.size, y.size, x.size)
    expected = np.ones(found.shape, bool)
    for p, c, side in zip(places(x, y, z), centre, (1.0, 0.8, 0.6), strict=True):
        expected &= np.abs(p - c) < side / 2
    assert expected.any()
    np.testing.assert_array_equal(found, expected)


def test_a_torus_is_what_its_equation_says():
    mesh = trimesh.creation.torus(0.6, 0.25, major_sections=192, minor_sections=96)
    axis = (np.arange(60) + 0.37) / 30 - 1
    x, y, z = places(axis, axis, axis)
    off = np.hypot(np.hypot(x, y) - 0.6, z) - 0.25
    clear = np.abs(off) > 5e-4  # the facets lie within the torus
    np.testing.assert_array_equal(body_of(mesh).holds(axis, axis, axis)[clear], (off < 0)[clear])


def test_lines_through_corners_and_edges_cross_once():
    """Columns at the corners' own x and y: every line hits corners, and many run along edges."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    x, y = (np.unique(mesh.vertices[:, k]) for k in (0, 1))
    z = np.linspace(-1.2, 1.2, 31)
    found = body_of(mesh).holds(x, y, z)
    radius = np.sqrt(sum(p**2 for p in places(x, y, z)))
    assert not found[radius > 1 + 1e-9].any()
    assert found[radius < 0.93].all()


def test_a_body_with_a_hollow_and_two_parts():
    parts = [
        trimesh.creation.icosphere(4, 1.0),
        trimesh.creation.icosphere(4, 0.5),
        trimesh.creation.box(bounds=((2, -1, -1), (3, 1, 1))),
    ]
    body = Body(np.concatenate([np.asarray(part.triangles) for part in parts]))
    at = body.holds(np.array([0.01, 0.75, 1.5, 2.5]), np.array([0.02]), np.array([0.03]))
    assert at.ravel().tolist() == [False, True, False, True]


def test_many_triangles_at_a_time_or_few_are_the_same(monkeypatch):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.9)
    axis = np.linspace(-1, 1, 23)
    whole = body_of(mesh).holds(axis, axis, axis)
    monkeypatch.setattr("plenopiv.body.AT_A_TIME", 7)
    np.testing.assert_array_equal(body_of(mesh).holds(axis, axis, axis), whole)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_files_of_both_kinds(tmp_path, kind):
    mesh = trimesh.creation.box(bounds=((-1, -2, -3), (4, 5, 6)))
    mesh.export(tmp_path / "wall.stl", file_type=kind)
    low, high = read_body(tmp_path / "wall.stl").limits_mm
    assert low.tolist() == [-1, -2, -3]
    assert high.tolist() == [4, 5, 6]


def test_files_that_hold_no_body(tmp_path):
    def complaint(name, content=None):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(PlenoPIVError) as caught:
            read_body(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
        return str(caught.value)

    mesh = trimesh.creation.box()
    whole = mesh.export(file_type="stl")
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    assert "its surface is not closed" in complaint("open.stl", mesh.export(file_type="stl"))
    assert "no such file" in complaint("none.stl")
    assert "STL files" in complaint("wall.step", b"ISO-10303-21;")
    for name, content in {
        "empty.stl": b"",
        "cut.stl": whole[:-30],
        "text.stl": b"solid nothing\nendsolid nothing\n",
        "words.stl": b"facet normal of the matter " * 20,
        "nan.stl": whole[:96] + np.array([np.nan] * 9, "<f4").tobytes() + whole[132:],
        "many.stl": whole[:80] + b"\xff\xff\xff\x7f" + whole[84:],
    }.items():
        complaint(name, content)
