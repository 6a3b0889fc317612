"""Makes ``tests/oracles`` importable: slow, obvious references that several rooms are tested against."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
os.environ.setdefault("NUMBA_NUM_THREADS", str(max(2, os.cpu_count() or 1)))  # no test for want of a core is left out

if "PYTEST_XDIST_WORKER" in os.environ:  # one thread each for NumPy's algebra too: a quarter of the tests' time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_configure(config):
    """One compute thread for each of several workers; tests of threads set their own number."""
    if hasattr(config, "workerinput"):
        import numba

        numba.set_num_threads(1)


@pytest.fixture
def one_thread():
    """One compute thread: a few voxels are no work to share."""
    import numba

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(threads)
