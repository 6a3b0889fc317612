"""MART asked of a projection that only takes notes: how many views at once, each how often, and what residual is
told."""

import numpy as np
import pytest

from plenopiv.reconstruction.mart import TOGETHER, mart
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2, 3, 4))
VIEWS, LENSES = 41, 6


class Notes:
    """A projection whose every pixel collects ``light`` whatever the volume holds."""

    def __init__(self, light=10.0, seen=None):
        self.light, self.views, self.groups = light, VIEWS, []
        self.seen = np.ones((VIEWS, LENSES), bool) if seen is None else seen

    def forward(self, views, volume):
        return np.full((len(views), LENSES), self.light, np.float32)

    def multiply(self, views, corrections, volume):
        self.groups.append((list(views), corrections.copy()))


def run(values, notes, **settings):
    volume = SparseVolume.from_mask(GRID, np.ones(GRID.shape, bool))
    return mart(values.astype(np.float32), notes, volume, **{"iterations": 2, "relaxation": 0.25} | settings)


@pytest.mark.parametrize("relaxation", [1.0, 0.5, 1 / 3, 0.25, 0.2, 0.125, 0.05])
def test_as_many_views_at_once_as_their_exponents_sum_to_two(relaxation):
    """A whole exponent stands alone; the first iteration takes twice the exponent, one at most."""
    notes = Notes()
    run(np.full((VIEWS, LENSES), 20.0), notes, relaxation=relaxation, floor=0.0)
    sizes = [len(views) for views, _ in notes.groups]
    counts = np.cumsum(sizes)
    first = int(np.searchsorted(counts, VIEWS)) + 1
    assert counts[first - 1] == VIEWS
    for exponent, group in ((min(2 * relaxation, 1.0), sizes[:first]), (relaxation, sizes[first:])):
        most = 1 if exponent == 1 else max(n for n in range(1, TOGETHER + 1) if n * exponent <= 2 + 1e-9)
        assert set(group[:-1]) == {most}
        assert group[-1] == VIEWS - most * (len(group) - 1)
    assert [corrections[0, 0] for _, corrections in notes.groups[:1]] == pytest.approx(
        [2 ** min(2 * relaxation, 1) - 1]
    )
    assert notes.groups[-1][1][0, 0] == pytest.approx(2**relaxation - 1, rel=1e-4)


def test_each_view_once_an_iteration_in_another_order():
    notes = Notes()
    run(np.full((VIEWS, LENSES), 20.0), notes)
    order = [view for views, _ in notes.groups for view in views]
    assert sorted(order[:VIEWS]) == sorted(order[VIEWS:]) == list(range(VIEWS))
    assert order[:VIEWS] != order[VIEWS:]


def test_the_residual_is_the_rms_of_seen_pixels():
    """Half of them 3 counts brighter than projected, half 4 darker, and what is not seen does not count."""
    seen = np.ones((VIEWS, LENSES), bool)
    seen[:, 4:] = False
    values = np.full((VIEWS, LENSES), 1000.0)
    values[:, :2], values[:, 2:4] = 103.0, 96.0
    _, residuals = run(values, Notes(100.0, seen))
    assert residuals == pytest.approx([np.sqrt((9 + 16) / 2)] * 2)
