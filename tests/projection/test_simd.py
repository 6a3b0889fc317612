"""Products of two rectangles, written in LLVM's terms, against plain sums."""

import numpy as np
import pytest

from plenopiv.kernels import kernel
from plenopiv.projection.plenoptic.plane_maps.simd import LANES, WIDEST, add_products, row_products

NX = 83
AT, BEGIN = 137, 5 * NX + 3
sizes = pytest.mark.parametrize(
    ("rows", "vectors"), [(r, v) for r in (0, 1, 3, 4, 5, 11, 17) for v in (1, 2, 3, WIDEST, WIDEST + 2)]
)


@kernel
def product(shares, columns, values, rows):
    return row_products(shares, AT, columns, values, BEGIN, NX, rows)


@kernel
def add(shares, columns, factor, values, rows):
    add_products(shares, AT, columns, factor, values, BEGIN, NX, rows)


def rectangles(rows, columns):
    """Random shares and values, and which of either are multiplied."""
    rng = np.random.default_rng(rows)
    shares, values = rng.random(3000).astype(np.float32), rng.random(40 * NX).astype(np.float32)
    row, column = np.mgrid[:rows, :columns]
    return shares, values, AT + row * columns + column, BEGIN + row * NX + column


@sizes
def test_product_of_rows(rows, vectors):
    shares, values, one, two = rectangles(rows, vectors * LANES)
    want = float(np.sum(shares[one].astype(float) * values[two]))
    assert product(shares, vectors * LANES, values, rows) == pytest.approx(want, rel=1e-6)


@sizes
def test_adding_rows(rows, vectors):
    shares, values, one, two = rectangles(rows, vectors * LANES)
    want = values.astype(float)
    want[two] += 0.7 * shares[one]
    add(shares, vectors * LANES, np.float32(0.7), values, rows)
    np.testing.assert_allclose(values, want, rtol=1e-6)
