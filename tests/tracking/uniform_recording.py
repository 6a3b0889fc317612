"""A small simulated recording of a uniform flow."""

import numpy as np

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

VELOCITY_M_S = np.array([0.11, -0.06, 0.17])  # 3.2, -1.8 and 1.1 voxels in 0.5 ms: another size and sign on each axis
DT_S = 5e-4
CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
    0.308,
    Sensor(320, 320, 0.0055, 12, 60),
)


def simulated(folder):
    """Write it into the folder."""
    simulate_recording(
        folder,
        CAMERA,
        flow("uniform", velocity_m_s=tuple(VELOCITY_M_S)),
        dt_s=DT_S,
        volume_mm=((-0.6, 0.6), (-0.6, 0.6), (-1.6, 1.6)),
        windows=((48, 48, 20), (32, 32, 16)),
        seeding=Seeding(0.4),
        rays=4000,
        seed=3,
    )
