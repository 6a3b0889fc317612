"""What a notebook shows of the public types: a line or two with units, no arrays; and all of it where it must be."""

from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from plenopiv.cameras.presets import preset
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.io.volumes import as_xarray
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.lightfield import LightField, layout
from plenopiv.recording import Recording
from plenopiv.refocusing import refocused, sub_aperture
from plenopiv.run.inputs import exactly
from plenopiv.run.series import RunResult
from plenopiv.sensor import Sensor
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-1.0, 1.0), (-0.5, 0.5), (-2.0, 2.0), (0.1, 0.1, 0.5))
CAMERA = preset("pmr8")


def displacements():
    zero = np.zeros((3, 2, 3, 4))
    valid = np.ones((2, 3, 4), bool)
    valid[0, 0, 0] = False
    axes = (10.0 * np.arange(n) for n in (2, 3, 4))
    moved = zero + np.array([1.0, 2.0, 3.0])[:, None, None, None]
    return DisplacementField(*axes, moved, moved, valid, np.ones((2, 3, 4), np.float32), zero)


def space():
    points = np.random.default_rng(0).random((200, 3))
    return SpaceMap.fitted(points, 2 * points, 3)


SHOWN = [
    (CAMERA, ("f = ", " mm", "M = ", "square", " px of ")),
    (CAMERA.lattice, ("pitch 0.044 mm", "deg")),
    (GRID, ("x -1 to 1", "z -2 to 2 mm", "20 x 10 x 8 voxels of 0.1 x 0.1 x 0.5 mm")),
    (DenseVolume(GRID, np.ones(GRID.shape, np.float32)), ("DenseVolume", "20 x 10 x 8 voxels")),
    (SparseVolume.from_mask(GRID, np.eye(10, 20, dtype=bool) & np.ones((8, 1, 1), bool)), ("80 voxels not empty",)),
    (layout(CAMERA), ("views of ", "microlenses")),
    (LightField(layout(CAMERA), np.zeros((2, 3), np.float32)), ("LightField", "counts")),
    (displacements(), ("4 x 3 x 2 vectors (x, y, z) in voxels, 1 replaced",)),
    (space(), ("degree 3", " mm")),
    (Chain((CAMERA,), GRID), ("Chain", "20 x 10 x 8 voxels")),
    (RunResult({"vectors": 70, "replaced_share": 0.1}, Path("r")), ("r: 1 of 1 pairs, 70 vectors, 10 % replaced",)),
]


@pytest.mark.parametrize(("shown", "words"), SHOWN, ids=lambda value: type(value).__name__)
def test_a_line_or_two(shown, words):
    text = repr(shown)
    assert len(text) < 500
    assert text.count("\n") <= 1
    assert "array(" not in text
    assert text.startswith("<")
    assert text.endswith(">")
    for word in words:
        assert word in text


def test_a_recording_names_its_first_and_last_frame(tmp_path):
    for k in range(5):
        tifffile.imwrite(tmp_path / f"f{k}.tif", np.zeros((8, 10), np.uint16))
    frames = tuple(sorted(tmp_path.glob("*.tif")))
    text = repr(Recording(Sensor(10, 8, 0.005), frames, None, 0.001, "upright"))
    assert text == (
        "<Recording 5 frames (f0.tif, ..., f4.tif), 4 pairs, dt 0.001 s, 10 x 8 px, upright, no white image>"
    )


def test_what_results_depend_on_is_written_to_the_last_bit():
    """``exactly`` is what dataclasses show of themselves where they are not told otherwise."""

    @dataclass(frozen=True)
    class Inner:
        pitch_mm: float
        hidden: int = field(default=0, repr=False)

    Outer = make_dataclass("Outer", ["one", "several", "table"])
    made = Outer(Inner(0.1), (Inner(0.2), None, "a"), {"x": (1.5,)})
    assert exactly(made) == repr(made)
    assert exactly((made,)) == repr((made,))
    bent = LatticeMap(1, 1.0, ((1e-3, 0.0), (0.0, 2e-3)))
    camera = replace(CAMERA, lattice=replace(CAMERA.lattice, map=bent))
    nearly = replace(
        CAMERA,
        lattice=replace(camera.lattice, map=replace(bent, coefficients_mm=((1e-3, 0.0), (0.0, np.nextafter(2e-3, 1))))),
    )
    assert exactly(camera) != exactly(nearly)
    assert "Lattice(kind='square', pitch_mm=0.077, rotation_rad=0.0" in exactly(Lattice("square", 0.077))


def test_fields_are_xarray_with_units():
    moved = displacements().as_xarray()
    assert moved.dx.dims == ("z", "y", "x")
    assert (float(moved.dy.mean()), moved.dz.units, int((~moved.valid).sum())) == (2.0, "voxel", 1)
    np.testing.assert_array_equal(moved.x, [0.0, 10.0, 20.0, 30.0])
    volume = SparseVolume.from_mask(GRID, np.eye(10, 20, dtype=bool) & np.ones((8, 1, 1), bool), 2.0)
    seen = as_xarray(volume)
    assert float(seen.sel(x=-0.95, y=-0.45, z=0.25, method="nearest")) == 2.0
    np.testing.assert_allclose(seen.x, GRID.axes()[0])
    where = layout(CAMERA)
    light = LightField(where, np.where(where.seen, 100.0, 0.0).astype(np.float32) * where.fill)
    for picture, z in ((sub_aperture(light, 0), 0.0), (refocused(light, 0.5), 0.5)):
        assert picture.dims == ("y", "x")
        assert picture.y[0] > picture.y[-1]
        assert picture.units == "counts"
        assert picture.z == z
