"""Predicted times are those that runs took.

Seconds measured on both cores of the machine that docs/speed.md names, of a frame's reconstruction and of a pair's
correlation, by windows themselves in three passes of the finest.
"""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks" / "accuracy"))

from conditions import CONDITIONS

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run.duration import of_settings
from plenopiv.volume import VoxelGrid

MEASURED_S = {
    "abc": (7.76, 4.61),
    "deep": (8.3, 3.6),
    "square-half": (2.8, 1.2),
    "base": (2.0, 0.7),
    "pmr8": (5.1, 1.8),
}


@pytest.mark.parametrize("name", MEASURED_S)
def test_frames_and_pairs_take_what_they_took(name):
    """Within a factor of 1.6; as fitted they are within 1.5."""
    condition, (frame, pair) = CONDITIONS[name], MEASURED_S[name]
    grid = VoxelGrid.covering(*condition.volume_mm(), condition.voxel_mm())
    correlation = CorrelationSettings(condition.windows, inner_window=condition.windows[-1], fine_passes=3)
    found = of_settings(condition.camera(), grid, ReconstructionSettings(), correlation, 2)
    print(f"\n{name}: frame {found.frame:.1f} of {frame} s, pair {found.pair:.1f} of {pair} s")
    assert 1 / 1.6 < found.frame / frame < 1.6
    assert 1 / 1.6 < found.pair / pair < 1.6
