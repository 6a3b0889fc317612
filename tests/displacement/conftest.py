"""Volumes of Gaussian particles whose displacement is known."""

import numpy as np
import pytest
from oracles import particle_volumes


@pytest.fixture(scope="session")
def particle_pair():
    """``make(shape, flow, density, sigma, ...)`` -> two volumes; ``flow`` maps (n, 3) mid-time positions x, y, z."""
    return particle_volumes.particle_pair


@pytest.fixture(scope="session")
def uniform_flow():
    return lambda d: lambda p: np.tile(np.asarray(d, float), (len(p), 1))
