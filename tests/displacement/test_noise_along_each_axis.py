"""Noise amplification has no preferred axis: windows turned by their axes give the same numbers, turned likewise."""

from itertools import permutations

import numpy as np
import pytest

from plenopiv.displacement.noise_amplification import noise_amplification
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.windows import window_grid

SIZES = (48, 24, 16)  # voxels; steps, tapers and the vectors in half a window differ from axis to axis


def amplification(sizes, counts=(9, 9, 9)):
    """Of so many windows of ``sizes`` (x, y, z) along each axis, without sub-windows."""
    shape = tuple(n * (count + 1) // 2 for n, count in zip(sizes[::-1], counts[::-1], strict=True))
    settings = CorrelationSettings(windows=(sizes,), inner_window=sizes, fine_passes=3)
    return noise_amplification(window_grid(shape, sizes, 0.5), settings)


@pytest.mark.parametrize("counts", [(9, 9, 9), (9, 7, 2), (2, 9, 9)])  # of two vectors no curvature is known
@pytest.mark.parametrize("order", permutations(range(3)))
def test_axes_may_be_exchanged(order, counts):
    straight = amplification(SIZES, counts)
    turned = amplification(tuple(SIZES[k] for k in order), tuple(counts[k] for k in order))
    assert turned.gain == pytest.approx(straight.gain, rel=1e-9)
    assert turned.bias_share == pytest.approx(straight.bias_share, rel=1e-9)
    # covariance is (z, y, x), sizes (x, y, z)
    axes = [2 - order[2 - axis] for axis in range(3)]
    np.testing.assert_allclose(turned.covariance, np.transpose(straight.covariance, axes), atol=1e-9)


def test_covariance_of_cubic_windows_is_the_same_along_all_axes():
    covariance = amplification((32, 32, 32)).covariance
    middle = covariance.shape[0] // 2
    assert covariance[middle, middle, middle] == pytest.approx(1.0)
    for axes in permutations(range(3)):
        np.testing.assert_allclose(np.transpose(covariance, axes), covariance, atol=1e-9)
