"""Sixteen samples of a volume side by side: the innermost step of deformation, in LLVM's terms (``butterflies``)."""

# numba calls the functions below with its typing context, which has no use here

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types

from plenopiv.displacement.butterflies import FUSED, INDEX, LANES, VECTOR, Intrinsic, load, pointer, store
from plenopiv.kernels import intrinsic
from plenopiv.kernels.numba_internals import cgutils


def _constant(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [value] * LANES)


def _cubic(builder: ir.IRBuilder, moved: ir.Value) -> tuple[ir.Value, ...]:
    """The four weights of the uniform cubic B-spline at the fractions of ``moved``."""
    kind = ir.FunctionType(VECTOR, [VECTOR])
    floor = cgutils.get_or_insert_function(builder.module, kind, f"llvm.floor.v{LANES}f32")
    minus, times = (lambda a, b, do=do: do(a, b, flags=FUSED) for do in (builder.fsub, builder.fmul))
    # whole and fractional parts apart: a float32 of the position itself would lose digits in large volumes
    t = minus(moved, builder.call(floor, [moved]))
    u = minus(_constant(1.0), t)
    t2, u2 = times(t, t), times(u, u)
    middle = [
        minus(_constant(2.0 / 3.0), times(square, minus(_constant(1.0), times(_constant(0.5), v))))
        for square, v in ((t2, t), (u2, u))
    ]
    return times(times(u2, u), _constant(1.0 / 6.0)), *middle, times(times(t2, t), _constant(1.0 / 6.0))


@intrinsic
def sample_sixteen(
    typing: Any,
    source: types.Array,
    at: types.Integer,
    row: types.Integer,
    plane: types.Integer,
    marks: types.Array,
    mark: types.Integer,
    blocks: types.Integer,
    layer: types.Integer,
    moved: types.Array,
    begin: types.Integer,
    step: types.Integer,
    out: types.Array,
) -> Intrinsic:
    """Samples i = 0 to 15 of the ``source`` (flat) with its cubic B-spline:

        out[i] = sum_abe wz_ai wy_bi wx_ei source[at + a plane + b row + e + i],    a, b, e = 0 to 3

    with weights at the fractions of ``moved[begin + i]``, along x, and of those ``step`` and 2 ``step`` further, along
    y and z. Lines are left out whose ``marks[mark + a layer + b blocks]`` is zero.
    """
    n = types.int64
    signature = types.void(source, n, n, n, marks, n, n, n, moved, n, n, out)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        source, at, row, plane, marks, mark, blocks, layer, moved, begin, step, out = arguments
        kinds = signature.args
        start = pointer(context, builder, kinds[0], source, at)
        marked = pointer(context, builder, kinds[4], marks, mark)
        displaced = pointer(context, builder, kinds[8], moved, begin)
        to = pointer(context, builder, kinds[11], out, ir.Constant(INDEX, 0))

        def steps(a: int, of_a: ir.Value, b: int = 0, of_b: ir.Value = step) -> ir.Value:
            """a of_a + b of_b."""
            a, b = (builder.mul(size, ir.Constant(INDEX, n)) for size, n in ((of_a, a), (of_b, b)))
            return builder.add(a, b)

        of_x, of_y, of_z = (_cubic(builder, load(builder, displaced, steps(c, step))) for c in range(3))

        def multiply_add(a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
            return builder.fadd(builder.fmul(a, b, flags=FUSED), c, flags=FUSED)

        total, in_plane = (cgutils.alloca_once(builder, VECTOR) for _ in range(2))
        builder.store(_constant(0.0), total)
        for a in range(4):
            builder.store(_constant(0.0), in_plane)
            for b in range(4):
                held = builder.load(builder.gep(marked, [steps(a, layer, b, blocks)]))
                with builder.if_then(builder.icmp_unsigned("!=", held, ir.Constant(held.type, 0))):
                    line = steps(a, plane, b, row)
                    along = _constant(0.0)
                    for e in range(4):
                        values = load(builder, start, builder.add(line, ir.Constant(INDEX, e)))
                        along = multiply_add(of_x[e], values, along)
                    builder.store(multiply_add(of_y[b], along, builder.load(in_plane)), in_plane)
            builder.store(multiply_add(of_z[a], builder.load(in_plane), builder.load(total)), total)
        store(builder, builder.load(total), to, ir.Constant(INDEX, 0))
        return context.get_dummy_value()

    return signature, generate
