"""The outlier test as it is set by default: what it rejects and what it keeps where vectors scatter as they do."""

import numpy as np
import pytest

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.validation import find_outliers

SCATTER = 0.1  # voxel, of good vectors
SHAPE = (9, 10, 11)


def judged(field):
    settings = CorrelationSettings()
    everywhere = np.ones(SHAPE, bool)
    return find_outliers(field, everywhere, settings.outlier_threshold, settings.outlier_floor_voxels)


@pytest.mark.parametrize("component", [0, 1, 2])
def test_a_vector_wrong_by_ten_scatters_is_found_and_good_ones_stay(component):
    """One voxel off in one component is found; good vectors are kept, but for one in a hundred at the volume's faces,
    where fewer neighbours judge."""
    rng = np.random.default_rng(component)
    field = SCATTER * rng.standard_normal((3, *SHAPE))
    good = judged(field)
    assert good.mean() < 0.015
    assert good[1:-1, 1:-1, 1:-1].mean() < 0.005
    wrong = np.zeros(SHAPE, bool)
    wrong[1::3, 1::3, 1::3] = True
    field[component, wrong] += rng.choice([-1.0, 1.0], wrong.sum())
    found = judged(field)
    assert found[wrong].mean() > 0.95
    assert found[~wrong].mean() < 0.015
