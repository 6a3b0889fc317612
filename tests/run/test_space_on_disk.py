"""What a run is to write is compared with the space on disk before anything is computed."""

import shutil
from types import SimpleNamespace

import pytest

from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.run.stored import BYTES_A_VECTOR, BYTES_OF_GRADIENTS, ask_for_space
from plenopiv.volume import VoxelGrid

WINDOWS = CorrelationSettings(windows=((16, 16, 8),))
VECTORS = 7 * 5 * 3


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """Ask for space with so many bytes free, on volumes of 64 x 48 voxels and so many planes."""

    def ask(free, *what, planes=16, **more):
        grid = VoxelGrid((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (planes, 48, 64))
        planned = SimpleNamespace(chain=SimpleNamespace(grid=grid, correlation=WINDOWS, lens_grid=grid))
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
        ask_for_space(SimpleNamespace(work=tmp_path, directory=tmp_path), planned, *what, **more)

    return ask


@pytest.mark.parametrize(
    ("pairs", "count", "gradients", "fields"),
    [(1, 1, False, 1), (5, 5, False, 10), (2, 5, False, 7), (0, 5, False, 5), (5, 5, True, 10)],
)
def test_each_pair_is_written_twice_and_gradients_with_it(asked, pairs, count, gradients, fields):
    needed = fields * VECTORS * (BYTES_A_VECTOR + (BYTES_OF_GRADIENTS if gradients else 0))
    asked(needed, pairs, count, gradients)
    with pytest.raises(PlenoPIVError, match=rf"fields of {count} pairs? take about .* GB more; make room"):
        asked(needed - 1, pairs, count, gradients)


def test_derivatives_of_one_layer_of_vectors_are_refused_beforehand(asked):
    asked(1e9, 1, 1, False, planes=8)
    with pytest.raises(PlenoPIVError, match=r"output\.gradients: vectors are 7 x 5 x 1 along x, y, z"):
        asked(1e9, 1, 1, True, planes=8)
