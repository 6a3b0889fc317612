"""The field of tracks on a grid, in parts that overlap."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import flow
from plenopiv.tracking.parts import field_on_grid

LIMITS = ((-2.4, 2.4), (-0.8, 0.8), (-0.6, 0.6))
AXES = (np.arange(-2.2, 2.3, 0.2), np.array([-0.4, 0.0, 0.4]), np.array([-0.3, 0.3]))
FLOW = flow("abc", wavelength_mm=4.0, amplitudes_m_s=(0.1, 0.12, 0.09))
STD = np.array([0.004, 0.004, 0.012])
STEP_MM = 0.37  # 13 cells along x: two parts


def tracks(low_mm=-2.4):
    """Position, velocity and standard deviations of tracks beyond x = ``low_mm``."""
    rng = np.random.default_rng(5)
    position = rng.uniform(*np.transpose(LIMITS), (1200, 3))
    std = np.broadcast_to(STD, position.shape)
    velocity = FLOW(position) + std * rng.standard_normal(position.shape)
    kept = position[:, 0] > low_mm
    return position[kept], velocity[kept], std[kept]


def truth():
    """The flow (3, nz, ny, nx) at the points of the grid."""
    z, y, x = np.meshgrid(*reversed(AXES), indexing="ij")
    return np.moveaxis(FLOW(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3), -1, 0)


@pytest.mark.full
def test_parts_are_one_field():
    found = field_on_grid(*tracks(), LIMITS, AXES, step_mm=STEP_MM)
    assert len(found.smoothing) == 2
    assert found.measured.all()
    off = found.velocity - truth()
    rms = np.sqrt((off**2).mean((1, 2, 3)))
    assert (rms < 0.4 * STD).all()
    seam = np.abs(np.diff(off, axis=3))[..., 9:13].max((1, 2, 3))  # parts meet at x = 0
    assert (seam < STD).all()
    assert (np.abs(off) < 2 * found.std).mean() > 0.85


def test_points_without_tracks_nearby_are_not_measured():
    found = field_on_grid(*tracks(low_mm=0.8), LIMITS, AXES, step_mm=STEP_MM)
    x = np.broadcast_to(AXES[0], found.measured.shape)
    assert found.measured[x > 1.0].all()
    assert not found.measured[x < 0.8 - 1.5 * STEP_MM].any()
    assert np.isnan(found.velocity[:, x < -0.5]).all()  # the other part has no tracks at all


@pytest.mark.full
def test_nodes_follow_the_density_of_tracks():
    position, velocity, std = tracks()
    dense, thin = (field_on_grid(position[::n], velocity[::n], std[::n], LIMITS, AXES).step_mm for n in (8, 16))
    assert thin == pytest.approx(2 ** (1 / 3) * dense)


def test_too_few_tracks():
    with pytest.raises(PlenoPIVError, match="10 tracks in the volume make no field, which takes 64"):
        field_on_grid(*(each[:10] for each in tracks()), LIMITS, AXES)
