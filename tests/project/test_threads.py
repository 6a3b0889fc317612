"""Ranges dealt out to threads."""

import os
import threading
import time
import weakref

import numba
import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # its BLAS is another one than NumPy's
from threadpoolctl import threadpool_info

from plenopiv.threads import each_in_threads, in_threads, in_turn, one_blas_thread


def mark(begin, end, seen):
    seen[begin:end] += 1


@pytest.mark.parametrize("count", [0, 1, 2, 3, 17])
def test_each_item_once(count):
    seen = np.zeros(count, int)
    in_threads(mark, count, seen)
    assert (seen == 1).all()


def test_what_a_range_raises_is_raised():
    def fails(begin, end):
        raise ValueError("a range")

    with pytest.raises(ValueError, match="a range"):
        in_threads(fails, 4)


@pytest.fixture
def four_threads():
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    before = numba.get_num_threads()
    numba.set_num_threads(min(4, numba.config.NUMBA_NUM_THREADS))
    yield
    numba.set_num_threads(before)


@pytest.mark.parametrize("failing", ["first", "last"])
def test_all_ranges_have_ended_once_one_has_raised(failing, four_threads):
    ended = []

    def fails(begin, end):
        if (begin == 0) == (failing == "first"):
            raise KeyError(begin)
        time.sleep(0.05)
        ended.append(begin)

    with pytest.raises(KeyError):
        in_threads(fails, 8)
    assert len(ended) == (numba.get_num_threads() - 1 if failing == "first" else 1)


def test_arguments_are_not_held(four_threads):
    seen = np.zeros(8, int)
    held = weakref.ref(seen)
    in_threads(mark, 8, seen)
    del seen
    until = time.monotonic() + 5  # a thread lets go after the caller has been told
    while held() is not None and time.monotonic() < until:
        time.sleep(0.001)
    assert held() is None


def test_several_callers_at_once():
    seen = [np.zeros(1000, int) for _ in range(4)]
    callers = [threading.Thread(target=in_threads, args=(mark, 1000, s)) for s in seen]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(10)
    assert all((s == 1).all() for s in seen)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread only")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    in_threads(mark, 8, np.zeros(8, int))
    child = os.fork()
    if child == 0:
        seen = np.zeros(8, int)
        in_threads(mark, 8, seen)
        os._exit(int(not (seen == 1).all()))
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize("count", [2, 16, 57, 260])
def test_planes_in_turn_share_out_what_is_near_the_middle(count):
    turns = in_turn(count)
    assert sorted(turns) == list(range(count))
    work = np.exp(-(((np.arange(count) - count / 2) / (0.2 * count)) ** 2))  # near focus it takes longest
    for threads in (2, 3, 4):
        if count >= 16:
            shares = [work[part].sum() / work.sum() for part in np.array_split(turns, threads)]
            assert max(shares) * threads < 1.25


def test_each_item_is_made_in_order_and_none_after_an_error():
    made = []

    def make(item):
        made.append(item)
        if item == 3:
            raise ValueError("three")
        time.sleep(0.01)
        return 2 * item

    assert list(each_in_threads(make, range(3))) == [0, 2, 4]
    with pytest.raises(ValueError, match="three"):
        list(each_in_threads(make, range(3, 200)))
    assert len(made) < 100


def test_blas_has_one_thread_and_then_as_many_as_before():
    def threads():
        return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]

    before = threads()
    with one_blas_thread():
        assert set(threads()) == {1}
    assert threads() == before
