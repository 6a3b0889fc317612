"""Interpolation between the points of a map, and its transpose: the inner loops of ``reading``, LANES places at once.

A place lies between four points, two neighbours of one row and two of the next; two neighbours are loaded and stored as
one number of 64 bits, which the compiler's vectoriser does not find. Written as LLVM instructions; for each place n the
same as

    above = values[at] + frac_x (values[at + 1] - values[at])
    below = values[at + width] + frac_x (values[at + width + 1] - values[at + width])
    image[begin + n] += factor lit[n] (above + frac_y (below - above))

and its transpose.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from llvmlite import ir
from numba import types

from plenopiv.kernels import intrinsic
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


def _interpolated(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, fraction: ir.Value) -> ir.Value:
    """a + fraction (b - a)"""
    return builder.fadd(a, builder.fmul(fraction, builder.fsub(b, a), flags=CONTRACT), flags=CONTRACT)


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
    frac_x: types.Array,
    frac_y: types.Array,
    lit: types.Array,
    offset: types.Integer,
    factor: types.Float,
    image: types.Array,
    begin: types.Integer,
) -> Intrinsic:
    """Add ``factor * lit`` times the interpolated ``values`` (rows of ``width``) at LANES places to ``image`` from
    ``begin`` on. Places are those from ``offset`` on of ``at`` (int32), ``frac_x``, ``frac_y`` and ``lit``; nothing is
    checked."""
    arrays = at, frac_x, frac_y, lit
    signature = types.void(values, types.int64, *arrays, types.int64, types.float32, image, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        kinds = signature.args
        values, at, frac_x, frac_y, lit, image = (
            data_of(context, builder, kinds[n], arguments[n]) for n in (0, 2, 3, 4, 5, 8)
        )
        width, offset, factor, begin = (arguments[n] for n in (1, 6, 7, 9))
        points = _points(builder, at, offset)
        above = [_load_pair(builder, _pair_at(builder, values, p)) for p in points]
        below = [_load_pair(builder, _pair_at(builder, values, builder.add(p, width))) for p in points]
        half, downs, mixed = LANES // 2, load_vector(builder, frac_y, offset), []
        for first in (0, half):
            twice = builder.shuffle_vector(downs, downs, _order(first + n // 2 for n in range(LANES)))
            a, b = (_joined(builder, pairs[first : first + half]) for pairs in (above, below))
            mixed.append(_interpolated(builder, a, b, twice))
        left, right = (builder.shuffle_vector(*mixed, _order(range(side, 2 * LANES, 2))) for side in (0, 1))
        light = _interpolated(builder, left, right, load_vector(builder, frac_x, offset))
        factors = builder.fmul(in_all_lanes(builder, factor), load_vector(builder, lit, offset))
        total = builder.fadd(
            load_vector(builder, image, begin), builder.fmul(factors, light, flags=CONTRACT), flags=CONTRACT
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
    frac_x: types.Array,
    frac_y: types.Array,
    lit: types.Array,
    offset: types.Integer,
    values: types.Array,
    width: types.Integer,
) -> Intrinsic:
    """The transpose of ``read_places`` but for its factor: add ``lit`` times the LANES numbers of ``image`` from
    ``begin`` on to ``values``, one place after the other."""
    arrays = at, frac_x, frac_y, lit
    signature = types.void(image, types.int64, *arrays, types.int64, values, types.int64)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        kinds = signature.args
        image, at, frac_x, frac_y, lit, values = (
            data_of(context, builder, kinds[n], arguments[n]) for n in (0, 2, 3, 4, 5, 7)
        )
        begin, offset, width = (arguments[n] for n in (1, 6, 8))
        whole = builder.fmul(load_vector(builder, lit, offset), load_vector(builder, image, begin))
        downs, right = load_vector(builder, frac_y, offset), load_vector(builder, frac_x, offset)
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
