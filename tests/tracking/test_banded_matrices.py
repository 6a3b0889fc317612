"""Banded matrices are factorised and solved as SciPy does it, on several threads at once."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from plenopiv.threads import one_blas_thread
from plenopiv.tracking import banded


def matrix(n, reach, seed):
    """Lower diagonals (reach + 1, n) of a positive definite matrix, and the matrix."""
    band = np.random.default_rng(seed).normal(size=(reach + 1, n))
    band[0] = 4.0 * reach
    dense = np.diag(band[0])
    for k in range(1, reach + 1):
        dense += np.diag(band[k, : n - k], -k) + np.diag(band[k, : n - k], k)
    return band, dense


def test_solutions_are_those_of_the_dense_matrix():
    band, dense = matrix(60, 7, 0)
    right = np.random.default_rng(1).normal(size=(60, 3))
    np.testing.assert_allclose(banded.solution(banded.factor(band), right), np.linalg.solve(dense, right), rtol=1e-11)


def test_bits_are_scipys_also_on_several_threads():
    several = [matrix(400, 90, seed)[0] for seed in range(6)]
    right = np.random.default_rng(2).normal(size=(400, 3))

    def solved(band):
        return banded.solution(banded.factor(band), right)

    with one_blas_thread(), ThreadPoolExecutor(3) as pool:
        for band, found in zip(several, pool.map(solved, several), strict=True):
            of_scipy = cho_solve_banded((cholesky_banded(band, lower=True), True), right)
            assert (found == of_scipy).all()


@pytest.mark.parametrize(("n", "reach"), [(60, 7), (300, 63), (300, 64), (130, 100), (200, 190), (70, 65), (400, 129)])
def test_many_right_sides_are_solved_in_blocks(n, reach):
    factor = banded.factor(matrix(n, reach, 4)[0])
    right = np.random.default_rng(5).normal(size=(n, 25))
    one_by_one = np.concatenate([banded.solution(factor, right[:, k : k + 1]) for k in range(25)], 1)
    np.testing.assert_allclose(banded.solution(factor, right), one_by_one, rtol=1e-11, atol=1e-15)


def test_what_is_given_stays_and_what_is_not_positive_definite_is_refused():
    band, _ = matrix(30, 4, 3)
    before, right = band.copy(), np.ones((30, 2))
    banded.solution(banded.factor(band), right)
    assert (band == before).all()
    assert (right == 1.0).all()
    band[0, 17] = -1.0
    with pytest.raises(LinAlgError, match="18 is not positive definite"):
        banded.factor(band)


def test_right_sides_of_another_size_are_refused():
    factor = banded.factor(matrix(30, 4, 3)[0])
    with pytest.raises(ValueError, match=r"right sides \(29, 1\)"):
        banded.solution(factor, np.ones((29, 1)))
    with pytest.raises(ValueError, match="Fortran"):
        banded.solution(np.ascontiguousarray(factor), np.ones((30, 1)))
