"""Makes ``tests/oracles`` importable: slow, obvious references that several rooms are tested against."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def one_thread():
    """One compute thread: a few voxels are no work to share."""
    import numba

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(threads)
