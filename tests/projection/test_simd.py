"""The product of two rectangles, written in LLVM's terms, against plain sums."""

import numpy as np
import pytest

from plenopiv.kernels import kernel
from plenopiv.projection.simd import LANES, row_products

NX = 61


@kernel
def product(shares, at, columns, values, begin, rows):
    return row_products(shares, at, columns, values, begin, NX, rows)


@pytest.mark.parametrize("columns", [LANES, 2 * LANES, 3 * LANES])
@pytest.mark.parametrize("rows", [0, 1, 3, 4, 5, 11, 17])
def test_product_of_rows(rows, columns):
    rng = np.random.default_rng(rows)
    shares, values = rng.random(2000).astype(np.float32), rng.random(40 * NX).astype(np.float32)
    at, begin = 137, 5 * NX + 3
    want = sum(
        float(shares[at + r * columns + x]) * float(values[begin + r * NX + x])
        for r in range(rows)
        for x in range(columns)
    )
    assert product(shares, at, columns, values, begin, rows) == pytest.approx(want, rel=1e-6)
