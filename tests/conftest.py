"""Makes ``tests/oracles`` importable: slow, obvious references that several rooms are tested against."""

import functools
import gc
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


@pytest.hookimpl(trylast=True)
def pytest_collection_finish():
    """What is there by now stays: the collector need not look through it again and again (4 % of the time)."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


@pytest.fixture
def one_thread():
    """One compute thread: a few voxels are no work to share."""
    import numba

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(threads)


@pytest.fixture(scope="session", autouse=True)
def each_white_image_once():
    """Fitting the lattice takes most of a check's time, a run begins with a check, and many tests have one white image.
    What a test makes of the fit it does not keep: a fit is frozen."""
    from plenopiv.checks import white

    def once(function):
        known = {}

        @functools.wraps(function)
        def remembered(image, camera, *name):
            key = image.tobytes(), camera
            if key not in known:
                known[key] = function(image, camera, *name)
            return known[key]

        return remembered

    with pytest.MonkeyPatch.context() as patch:
        for name in ("find_lattice", "aperture_disc"):
            patch.setattr(white, name, once(getattr(white, name)))
        yield
