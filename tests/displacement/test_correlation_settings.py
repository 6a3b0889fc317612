"""Settings of a correlation as Python gives them: lists are sizes too, and what is no size is refused."""

import numpy as np
import pytest

from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError


def test_lists_are_what_tuples_are():
    tuples = CorrelationSettings(windows=((96, 96, 24), (48, 48, 16)), inner_window=(24, 24, 8))
    windows = [[96, 96, 24], [48.0, 48.0, 16.0]]
    lists = CorrelationSettings(windows, inner_window=[24, 24, 8], smoothing_voxels=[1.0, 1.0, 0.8], fine_passes=2.0)
    assert lists == tuples == CorrelationSettings(np.array(windows), inner_window=np.array([24, 24, 8]))
    assert averaged_share(lists) == averaged_share(tuples)
    assert lists.passes == tuples.passes
    assert all(type(side) is int for window in lists.windows for side in window)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"windows": (32, 32, 16)}, r"windows: \[32, 32, 16\]: give sizes \[x, y, z\] of 8 voxels or more"),
        ({"windows": 32}, r"windows: 32: give sizes \[x, y, z\]"),
        ({"windows": []}, r"windows: \[\]: give sizes"),
        ({"windows": ((32.5, 32, 16),)}, r"windows: \[\[32.5, 32, 16\]\]: give sizes"),
        ({"windows": ((32, np.nan, 16),)}, r"windows: \[\[32, nan, 16\]\]: give sizes"),
        ({"windows": ((32, 32),)}, r"windows: \[\[32, 32\]\]: give sizes"),
        ({"windows": ("888",)}, "windows: .888.: give sizes"),
        ({"inner_window": 16}, r"inner_window: 16: give a size \[x, y, z\]"),
        ({"inner_window": [16, 16]}, r"inner_window: \[16, 16\]: give a size"),
        ({"inner_window": [7, 16, 16]}, r"inner_window: \[7, 16, 16\]: give a size"),
        ({"smoothing_voxels": (1, 1)}, r"smoothing_voxels: \[1, 1\]: give one number, or three along x, y, z"),
        ({"smoothing_voxels": [1, 1, 5]}, "smoothing_voxels: 5 is out of range; use 0.0 to 4.0"),
        ({"smoothing_voxels": "1"}, "smoothing_voxels: 1: give one number"),
        ({"fine_passes": 1.5}, "fine_passes: 1.5 is no whole number; use 1 to 20"),
        ({"overlap": "0.5"}, "overlap: 0.5 is out of range"),
    ],
)
def test_what_is_no_size_is_refused(settings, message):
    with pytest.raises(PlenoPIVError, match=rf"^correlation.{message}"):
        CorrelationSettings(**settings)
