"""The two inner loops that a compiler's vectoriser does not get right: sums and additions over two small rectangles.

A loop over rows of 8 to 24 columns ends each row with a sum across the vector, or with a check how many columns are
left, which takes longer than the products. Here a row is as many whole vectors as it has columns, a number looked up
once for all rows, and sums stay vectors to the end. Written as LLVM instructions; the same as

    sum(weights[at + r * columns + x] * values[begin + r * nx + x] for r in range(rows) for x in range(columns))
    values[begin + r * nx + x] += factor * weights[at + r * columns + x]

in a fixed order.
"""

# numba calls the functions below with its typing context, which has no use here

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types

from plenopiv.kernels import intrinsic
from plenopiv.kernels.numba_internals import cgutils

LANES = 8
WIDEST = 6  # vectors of a row up to which each number has code of its own
INDEX, LANE = ir.IntType(64), ir.IntType(32)
VECTOR = ir.VectorType(ir.FloatType(), LANES)
ZERO = ir.Constant(VECTOR, [0.0] * LANES)

Intrinsic = tuple[Any, Callable[..., ir.Value]]  # signature, and what writes its code


def vector_at(builder: ir.IRBuilder, start: ir.Value, offset: ir.Value) -> ir.Value:
    """Pointer to LANES numbers from ``offset`` on."""
    return builder.bitcast(builder.gep(start, [offset]), VECTOR.as_pointer())


def load_vector(builder: ir.IRBuilder, start: ir.Value, offset: ir.Value) -> ir.Value:
    """LANES numbers from ``offset`` on."""
    vector = builder.load(vector_at(builder, start, offset))
    vector.align = 4
    return vector


def in_all_lanes(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    """A vector of LANES times the same number."""
    vector = ir.Constant(VECTOR, ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, number, ir.Constant(LANE, lane))
    return vector


def data_of(context: Any, builder: ir.IRBuilder, kind: types.Array, array: ir.Value) -> ir.Value:
    """Pointer to the numbers of an array."""
    return context.make_array(kind)(context, builder, array).data


def _for_each_row(
    builder: ir.IRBuilder,
    columns: ir.Value,
    rows: ir.Value,
    weights: ir.Value,
    values: ir.Value,
    nx: ir.Value,
    work: Callable[[int, ir.Value, ir.Value], None],
) -> None:
    """``work(vectors, weight, value)`` for each row, with pointers to its first weight and value and the number of
    vectors in a row; where these are more than WIDEST, for one vector after the other."""
    for vectors in range(1, WIDEST + 1):
        known = builder.icmp_signed("==", columns, ir.Constant(INDEX, vectors * LANES))
        with builder.if_then(known), cgutils.for_range(builder, rows) as row:
            weight = builder.gep(weights, [builder.mul(row.index, ir.Constant(INDEX, vectors * LANES))])
            work(vectors, weight, builder.gep(values, [builder.mul(row.index, nx)]))
    wide = builder.icmp_signed(">", columns, ir.Constant(INDEX, WIDEST * LANES))
    with builder.if_then(wide), cgutils.for_range(builder, rows) as row:
        first, value = builder.mul(row.index, columns), builder.mul(row.index, nx)
        with cgutils.for_range(builder, builder.sdiv(columns, ir.Constant(INDEX, LANES))) as block:
            x = builder.mul(block.index, ir.Constant(INDEX, LANES))
            work(1, builder.gep(weights, [builder.add(first, x)]), builder.gep(values, [builder.add(value, x)]))


@intrinsic
def row_products(
    typing: Any,
    weights: types.Array,
    at: types.Integer,
    columns: types.Integer,
    values: types.Array,
    begin: types.Integer,
    nx: types.Integer,
    rows: types.Integer,
) -> Intrinsic:
    """Sum of the products of ``rows`` x ``columns`` float32 ``weights`` (a rectangle at ``at``) and ``values`` (rows of
    ``nx`` from ``begin``). ``columns`` is a multiple of LANES; nothing is checked."""
    signature = types.float32(weights, types.int64, types.int64, values, types.int64, types.int64, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        one, at, columns, two, begin, nx, rows = arguments
        one = builder.gep(data_of(context, builder, signature.args[0], one), [at])
        two = builder.gep(data_of(context, builder, signature.args[3], two), [begin])
        sums = [cgutils.alloca_once_value(builder, ZERO) for _ in range(WIDEST)]
        for total in sums:  # the stack's slot is filled once, on entry
            builder.store(ZERO, total)

        def multiply(vectors: int, weight: ir.Value, value: ir.Value) -> None:
            for n in range(vectors):
                offset = ir.Constant(INDEX, n * LANES)
                product = builder.fmul(
                    load_vector(builder, weight, offset), load_vector(builder, value, offset), flags=("contract",)
                )
                builder.store(builder.fadd(builder.load(sums[n]), product, flags=("contract",)), sums[n])

        _for_each_row(builder, columns, rows, one, two, nx, multiply)
        vector = builder.load(sums[0])
        for total in sums[1:]:
            vector = builder.fadd(vector, builder.load(total))
        result = ir.Constant(ir.FloatType(), 0.0)
        for lane in range(LANES):
            result = builder.fadd(result, builder.extract_element(vector, ir.Constant(LANE, lane)), flags=("reassoc",))
        return result

    return signature, generate


@intrinsic
def add_products(
    typing: Any,
    weights: types.Array,
    at: types.Integer,
    columns: types.Integer,
    factor: types.Float,
    values: types.Array,
    begin: types.Integer,
    nx: types.Integer,
    rows: types.Integer,
) -> Intrinsic:
    """Add ``factor`` times ``rows`` x ``columns`` of ``weights`` to ``values``, laid out as for ``row_products``."""
    integers = types.int64, types.int64
    signature = types.void(weights, *integers, types.float32, values, *integers, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        one, at, columns, factor, two, begin, nx, rows = arguments
        one = builder.gep(data_of(context, builder, signature.args[0], one), [at])
        two = builder.gep(data_of(context, builder, signature.args[4], two), [begin])
        factors = in_all_lanes(builder, factor)

        def add(vectors: int, weight: ir.Value, value: ir.Value) -> None:
            for n in range(vectors):
                offset = ir.Constant(INDEX, n * LANES)
                product = builder.fmul(load_vector(builder, weight, offset), factors, flags=("contract",))
                total = builder.fadd(load_vector(builder, value, offset), product, flags=("contract",))
                builder.store(total, vector_at(builder, value, offset)).align = 4

        _for_each_row(builder, columns, rows, one, two, nx, add)
        return context.get_dummy_value()

    return signature, generate
