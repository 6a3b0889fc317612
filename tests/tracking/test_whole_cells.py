"""Light of whole cells from their table: against the integrals along their edges, and where there is no table."""

import numpy as np
import pytest
from test_light_of_particles import BENT, HEXAGONAL, SQUARE, image_of

from plenopiv.tracking import light
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.whole_cells import LARGEST_PX, SHARPEST_PX, CellTables, cell_tables

PLACES = [(0.05, -0.11, 1.1), (-0.2, 0.13, -1.6), (0.11, 0.02, -3.3), (-0.03, -0.21, 4.1), (0.3, 0.3, -7.0)]
AT_THE_EDGE = [(0.82, 0.1, 2.4), (-0.1, -0.75, -3.0)]


def images_of(camera, lights, place):
    """Shares and their derivatives by x, y and z."""
    found = lights([place])
    return [image_of(camera, found, each) for each in (found.share, *found.gradient.T)]


@pytest.mark.parametrize("place", PLACES + AT_THE_EDGE)
@pytest.mark.parametrize("camera", [HEXAGONAL, SQUARE, BENT], ids=["hexagonal", "square", "bent"])
def test_light_from_the_table_is_that_of_edges(camera, place, monkeypatch):
    tabulated = PointLights(camera)
    assert tabulated._tables.cells.values.size > 0
    found = images_of(camera, tabulated, place)
    monkeypatch.setattr(light, "cell_tables", lambda corner, blur_px: CellTables(corner, blur_px, 0.0))
    exact = images_of(camera, PointLights(camera), place)
    assert np.abs(found[0] - exact[0]).max() < 1e-3 * exact[0].max()
    for one, other in zip(found[1:], exact[1:], strict=True):
        assert np.linalg.norm(one - other) < 5e-3 * np.linalg.norm(other)


def test_sizes_are_made_when_they_are_asked_for():
    corner = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
    tables = CellTables(corner, 0.2, LARGEST_PX)
    tables.make(np.array([1.02]))
    assert tables._made.sum() == 1
    tables.make(np.array([1.02, 0.5, 10.0 * LARGEST_PX, 0.0]))  # beyond both ends there are none
    assert tables._made.sum() == 2
    between = CellTables(corner, 0.2, LARGEST_PX)
    between.make(np.array([3.5 * between.cells.size_step]))  # a kernel may take either side of it
    assert np.flatnonzero(between._made).tolist() == [2, 3]
    assert cell_tables(corner, 0.5 * SHARPEST_PX).cells.values.size == 0
    assert cell_tables(corner, 0.2) is cell_tables(corner.copy(), 0.2)


def test_light_of_a_whole_cell_is_its_area():
    """With no derivative by place, and that of the area by size."""
    corner = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
    tables = CellTables(corner, 0.2, LARGEST_PX)
    tables.make(np.array([1.3]))
    cells = tables.cells
    k = int(np.flatnonzero(tables._made)[0])
    side = 2 * cells.half[k] + 1
    values = cells.values[cells.first[k] : cells.first[k + 1]].reshape(cells.steps**2, side**2, 10)
    assert values[:, :, 0].sum(1) == pytest.approx(1.0, abs=1e-3)
    assert np.abs(values[:, :, 1:4].sum(1)).max() < 0.02
