"""What a frame takes of the device's memory, by the compiled programs."""

import pytest
from oracles.cameras import small_camera

pytest.importorskip("jax")

import jax

from plenopiv.device.memory import frame_bytes
from plenopiv.device.projection import on_device
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

SETTINGS = ReconstructionSettings(relaxation=1.0)  # one view at a time: one program


@pytest.mark.full
def test_a_volume_is_held_once_and_a_frame_beside_it():
    """Deep, so that a plane's maps are little beside the volume; what tiles take is less."""
    where = layout(small_camera("square", pmr=8, microlenses=(9, 19)))
    projector = PlenopticProjector(where, VoxelGrid.covering((-0.1, 0.1), (-0.4, 0.4), (8.0, 8.6), (0.01, 0.01, 0.002)))
    volume, frame = 4 * projector.grid.size, 9 * where.views * where.lenses
    found = frame_bytes(projector, SETTINGS, background=True)
    tables = sum(each.nbytes for each in jax.tree.leaves(on_device(projector).tables))
    assert volume + frame < found < 1.3 * (volume + frame) + tables
    of_a_tile = frame_bytes(projector, SETTINGS, cut(projector.grid.shape[1], 2, 8))
    assert 0.4 * (volume + frame) < of_a_tile - (found - volume - frame) < 0.75 * (volume + frame)
