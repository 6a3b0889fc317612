"""Transforms of lines and windows against NumPy's."""

import numpy as np
import pytest

from plenopiv.displacement.butterflies import LANES, transpose
from plenopiv.displacement.transforms import POINT, fast_length, forward, inverse, lines, rounded_up, transform
from plenopiv.kernels import kernel


def packed(points):
    """Complex points (count, LANES) as vectors of real and imaginary parts."""
    return np.stack([points.real, points.imag], 1).astype(np.float32).ravel()


def unpacked(flat, count):
    real, imag = np.moveaxis(flat[: count * POINT].reshape(count, 2, LANES), 1, 0)
    return real + 1j * imag


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 8, 9, 12, 15, 16, 25, 27, 60, 64, 75, 128])
def test_lines_are_transformed(count):
    """Every radix, alone and with others; and back, with real and imaginary parts exchanged."""
    rng = np.random.default_rng(count)
    points = rng.standard_normal((count, LANES)) + 1j * rng.standard_normal((count, LANES))
    plan, source, work = lines(count), packed(points), np.zeros(2 * count * POINT, np.float32)
    target = np.zeros_like(source)
    transform(plan, source, 0, POINT, LANES, target, 0, POINT, LANES, work)
    np.testing.assert_allclose(unpacked(target, count), np.fft.fft(points, axis=0), atol=2e-6 * count)
    transform(plan, target, LANES, POINT, -LANES, source, LANES, POINT, -LANES, work)
    np.testing.assert_allclose(unpacked(source, count), count * points, atol=4e-6 * count)


def test_fast_lengths_have_small_factors():
    assert [fast_length(n) for n in (1, 7, 11, 14, 16, 31, 61, 121)] == [1, 8, 12, 15, 16, 32, 64, 125]
    assert [rounded_up(n) for n in (1, 16, 17)] == [16, 16, 32]


@kernel
def transposed(source, target):
    transpose(source, 0, 20, target, 0, 16)


def test_a_square_is_transposed():
    source = np.arange(320, dtype=np.float32)
    target = np.zeros(256, np.float32)
    transposed(source, target)
    np.testing.assert_array_equal(target.reshape(16, 16), source.reshape(16, 20)[:, :16].T)


@pytest.mark.parametrize("size", [(4, 5, 6), (16, 18, 20), (3, 32, 9), (8, 16, 48)])
def test_windows_are_transformed_and_back(size):
    rng = np.random.default_rng(1)
    pair = rng.standard_normal((2, *size))
    (nz, ny, nx), (high, wide) = size, map(rounded_up, size[1:])
    plans = tuple(lines(n) for n in size)
    space = np.zeros((2, nz, high, wide), np.float32)
    space[:, :, :ny, :nx] = pair
    spectrum, rows = np.zeros(2 * nz * nx * high, np.float32), np.zeros(2 * high * wide, np.float32)
    work = np.zeros(3 * POINT * max(wide, *size), np.float32)
    forward(plans, wide, high, space.reshape(-1), rows, spectrum, work)
    got = spectrum.reshape(2, nz, nx, high)[..., :ny].transpose(0, 1, 3, 2)
    np.testing.assert_allclose(got[0] + 1j * got[1], np.fft.fftn(pair[0] + 1j * pair[1]), atol=1e-3)
    inverse(plans, wide, high, spectrum, rows, space.reshape(-1), work)
    np.testing.assert_allclose(space[:, :, :ny, :nx], nz * ny * nx * pair, rtol=1e-4, atol=1e-5 * nz * ny * nx)
