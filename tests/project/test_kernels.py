"""How kernels are compiled: parts, borrowed arguments, the collector of dead cycles."""

import gc

import numpy as np

from plenopiv.kernels import borrowed, kernel, part


@part
def doubled(x):
    return x + x


@kernel
def fill_with_doubled(source, out):
    source, out = borrowed((source, out))
    for i in range(source.size):
        out[i] = doubled(source[i])


def test_a_part_is_compiled_into_kernels_and_plain_python_elsewhere():
    source, out = np.array([1.5, -2.0], np.float32), np.zeros(2, np.float32)
    fill_with_doubled(source, out)
    np.testing.assert_array_equal(out, [3.0, -4.0])
    compiled = len(doubled.signatures)  # none where the kernel came from the cache
    assert doubled("ab") == "abab"  # no number: nothing that is compiled would take it
    assert len(doubled.signatures) == compiled <= 1


def test_borrowed_arguments_outlive_the_kernel():
    source, out = np.ones(1000), np.zeros(1000)
    for _ in range(100):
        fill_with_doubled(source, out)
    del source
    gc.collect()
    assert (out == 2).all()


def test_the_collector_is_as_it_was_after_a_compilation():
    usual = gc.get_threshold()
    fill_with_doubled.recompile()
    assert gc.get_threshold() == usual
    gc.disable()
    try:
        fill_with_doubled.recompile()
        assert not gc.isenabled()
        assert gc.get_threshold() == usual
    finally:
        gc.enable()
