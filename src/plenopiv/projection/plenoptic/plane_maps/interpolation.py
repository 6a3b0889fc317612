"""Reading a map between its points, and writing there: the inner loops of ``strips``, LANES places at once.

A place lies between four points, two neighbours of one row and two of the next; neighbours are loaded and stored as one
number of 64 bits, which the compiler's vectoriser does not find. Written in LLVM's terms; for each place n the same as

    above = values[at] + across (values[at + 1] - values[at])
    below = values[at + width] + across (values[at + width + 1] - values[at + width])
    into[begin + n] += factor share[n] (above + along (below - above))

and its transpose.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from plenopiv.projection.plenoptic.plane_maps.simd import (
    INDEX,
    LANE,
    LANES,
    Intrinsic,
    data_of,
    in_all_lanes,
    load_vector,
    vector_at,
)

PAIR = ir.VectorType(ir.FloatType(), 2)
CONTRACT = ("contract",)


def _order(numbers: Iterable[int]) -> ir.Constant:
    lanes = list(numbers)
    return ir.Constant(ir.VectorType(LANE, len(lanes)), lanes)


def _joined(builder: ir.IRBuilder, parts: Sequence[ir.Value]) -> ir.Value:
    """Vectors end to end."""
    while len(parts) > 1:
        size = 2 * parts[0].type.count
        parts = [
            builder.shuffle_vector(a, b, _order(range(size))) for a, b in zip(parts[::2], parts[1::2], strict=True)
        ]
    return parts[0]


def _pair_at(builder: ir.IRBuilder, values: ir.Value, point: ir.Value) -> ir.Value:
    return builder.bitcast(builder.gep(values, [point]), PAIR.as_pointer())


def _load_pair(builder: ir.IRBuilder, start: ir.Value) -> ir.Value:
    pair = builder.load(start)
    pair.align = 4
    return pair


def _mixed(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, share: ir.Value) -> ir.Value:
    """a + share (b - a)"""
    return builder.fadd(a, builder.fmul(share, builder.fsub(b, a), flags=CONTRACT), flags=CONTRACT)


def _points(builder: ir.IRBuilder, at: ir.Value, offset: ir.Value) -> list[ir.Value]:
    """The point above and to the left of each of LANES places."""
    return [
        builder.zext(builder.load(builder.gep(at, [builder.add(offset, ir.Constant(INDEX, lane))])), INDEX)
        for lane in range(LANES)
    ]


@intrinsic
def read_places(
    typing: Any,
    values: types.Array,
    width: types.Integer,
    at: types.Array,
    across: types.Array,
    along: types.Array,
    share: types.Array,
    offset: types.Integer,
    factor: types.Float,
    image: types.Array,
    begin: types.Integer,
) -> Intrinsic:
    """Add ``factor * share`` times what ``values`` (rows of ``width``) are at LANES places to ``image`` from ``begin``.
    Places are those from ``offset`` on of ``at`` (int32), ``across``, ``along`` and ``share``; nothing is checked."""
    arrays = at, across, along, share
    signature = types.void(values, types.int64, *arrays, types.int64, types.float32, image, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        kinds = signature.args
        values, at, across, along, share, image = (
            data_of(context, builder, kinds[n], arguments[n]) for n in (0, 2, 3, 4, 5, 8)
        )
        width, offset, factor, begin = (arguments[n] for n in (1, 6, 7, 9))
        points = _points(builder, at, offset)
        above = [_load_pair(builder, _pair_at(builder, values, p)) for p in points]
        below = [_load_pair(builder, _pair_at(builder, values, builder.add(p, width))) for p in points]
        half, downs, mixed = LANES // 2, load_vector(builder, along, offset), []
        for first in (0, half):
            twice = builder.shuffle_vector(downs, downs, _order(first + n // 2 for n in range(LANES)))
            a, b = (_joined(builder, pairs[first : first + half]) for pairs in (above, below))
            mixed.append(_mixed(builder, a, b, twice))
        left, right = (builder.shuffle_vector(*mixed, _order(range(side, 2 * LANES, 2))) for side in (0, 1))
        light = _mixed(builder, left, right, load_vector(builder, across, offset))
        shares = builder.fmul(in_all_lanes(builder, factor), load_vector(builder, share, offset))
        total = builder.fadd(
            load_vector(builder, image, begin), builder.fmul(shares, light, flags=CONTRACT), flags=CONTRACT
        )
        builder.store(total, vector_at(builder, image, begin)).align = 4
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def write_places(
    typing: Any,
    image: types.Array,
    begin: types.Integer,
    at: types.Array,
    across: types.Array,
    along: types.Array,
    share: types.Array,
    offset: types.Integer,
    values: types.Array,
    width: types.Integer,
) -> Intrinsic:
    """The transpose of ``read_places`` but for its factor: add ``share`` times the LANES numbers of ``image`` from
    ``begin`` on to ``values``, one place after the other."""
    arrays = at, across, along, share
    signature = types.void(image, types.int64, *arrays, types.int64, values, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        kinds = signature.args
        image, at, across, along, share, values = (
            data_of(context, builder, kinds[n], arguments[n]) for n in (0, 2, 3, 4, 5, 7)
        )
        begin, offset, width = (arguments[n] for n in (1, 6, 8))
        whole = builder.fmul(load_vector(builder, share, offset), load_vector(builder, image, begin))
        downs, right = load_vector(builder, along, offset), load_vector(builder, across, offset)
        below = builder.fmul(downs, whole)
        rows = []
        for row in (builder.fsub(whole, below), below):
            beyond = builder.fmul(right, row)
            near = builder.fsub(row, beyond)
            rows.append([
                builder.shuffle_vector(near, beyond, _order((n, LANES + n))) for n in range(LANES)
            ])  # fmt: skip
        for lane, point in enumerate(_points(builder, at, offset)):
            for pairs, p in zip(rows, (point, builder.add(point, width)), strict=True):
                place = _pair_at(builder, values, p)
                builder.store(builder.fadd(_load_pair(builder, place), pairs[lane]), place).align = 4
        return context.get_dummy_value()

    return signature, generate
