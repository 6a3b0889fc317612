"""The innermost steps of a Fourier transform, on sixteen lines side by side: butterflies, and 16 x 16 transpositions.

A line's complex points are pairs of vectors, sixteen real parts and, ``apart`` floats further, sixteen imaginary ones;
one lane is one line, so that no step of a transform crosses lanes. Written in LLVM's terms: a compiler that sees loops
over sixteen elements of up to sixteen places of an array cannot tell that they do not overlap, and stays scalar.
"""

# numba calls the functions below with its typing context, which has no use here

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, pi, sin
from typing import Any

from llvmlite import ir
from numba import types

from plenopiv.kernels import intrinsic

LANES = 16
INDEX, LANE, FLOAT = ir.IntType(64), ir.IntType(32), ir.FloatType()
VECTOR = ir.VectorType(FLOAT, LANES)
FUSED = ("contract",)

Complex = tuple[ir.Value, ir.Value]  # vectors of real and imaginary parts
Intrinsic = tuple[Any, Callable[..., ir.Value]]  # signature, and what writes its code


def pointer(context: Any, builder: ir.IRBuilder, kind: types.Array, array: ir.Value, at: ir.Value) -> ir.Value:
    """Where an array's numbers from ``at`` on begin."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


def load(builder: ir.IRBuilder, start: ir.Value, offset: ir.Value) -> ir.Value:
    """The LANES numbers from ``offset`` on."""
    vector = builder.load(builder.bitcast(builder.gep(start, [offset]), VECTOR.as_pointer()))
    vector.align = 4
    return vector


def store(builder: ir.IRBuilder, vector: ir.Value, start: ir.Value, offset: ir.Value) -> None:
    """Write LANES numbers from ``offset`` on."""
    builder.store(vector, builder.bitcast(builder.gep(start, [offset]), VECTOR.as_pointer())).align = 4


def all_lanes(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """A vector of LANES times the same number."""
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), value, ir.Constant(LANE, 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(LANE, LANES), [0] * LANES))


class _Arithmetic:
    """Complex numbers as pairs of vectors."""

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.builder = builder

    def plus(self, a: Complex, b: Complex) -> Complex:
        return tuple(self.builder.fadd(u, v, flags=FUSED) for u, v in zip(a, b, strict=True))

    def minus(self, a: Complex, b: Complex) -> Complex:
        return tuple(self.builder.fsub(u, v, flags=FUSED) for u, v in zip(a, b, strict=True))

    def scaled(self, a: Complex, factor: float) -> Complex:
        constant = ir.Constant(VECTOR, [factor] * LANES)
        return tuple(self.builder.fmul(u, constant, flags=FUSED) for u in a)

    def product(self, a: Complex, b: Sequence[ir.Value]) -> Complex:
        multiply = self.builder.fmul
        real = self.builder.fsub(multiply(a[0], b[0], flags=FUSED), multiply(a[1], b[1], flags=FUSED), flags=FUSED)
        imag = self.builder.fadd(multiply(a[0], b[1], flags=FUSED), multiply(a[1], b[0], flags=FUSED), flags=FUSED)
        return real, imag

    def minus_i_times(self, a: Complex, b: Complex) -> Complex:
        """a - i b."""
        return self.builder.fadd(a[0], b[1], flags=FUSED), self.builder.fsub(a[1], b[0], flags=FUSED)

    def plus_i_times(self, a: Complex, b: Complex) -> Complex:
        """a + i b."""
        return self.builder.fsub(a[0], b[1], flags=FUSED), self.builder.fadd(a[1], b[0], flags=FUSED)

    def transform(self, x: list[Complex]) -> list[Complex]:
        """The discrete transform sum_j x_j exp(-2 pi i j k / n) of the n points ``x``: 2, 4 or an odd number."""
        n = len(x)
        if n == 2:
            return [self.plus(*x), self.minus(*x)]
        if n == 4:
            even, even_less = self.plus(x[0], x[2]), self.minus(x[0], x[2])
            odd, odd_less = self.plus(x[1], x[3]), self.minus(x[1], x[3])
            first, third = self.minus_i_times(even_less, odd_less), self.plus_i_times(even_less, odd_less)
            return [self.plus(even, odd), first, self.minus(even, odd), third]
        half = range(1, n // 2 + 1)
        sums, steps = [self.plus(x[j], x[n - j]) for j in half], [self.minus(x[j], x[n - j]) for j in half]
        out = [x[0]] * n
        for s in sums:
            out[0] = self.plus(out[0], s)
        for k in half:
            a, b = x[0], None
            for j, s, d in zip(half, sums, steps, strict=True):
                a = self.plus(a, self.scaled(s, cos(2 * pi * j * k / n)))
                turned = self.scaled(d, sin(2 * pi * j * k / n))
                b = turned if b is None else self.plus(b, turned)
            assert b is not None
            out[k], out[n - k] = self.minus_i_times(a, b), self.plus_i_times(a, b)
        return out


def butterfly(radix: int) -> Callable[..., None]:
    """An intrinsic that transforms ``radix`` points ``step`` floats apart from ``at`` on in ``source`` and writes them,
    the k-th times the k-th factor (k >= 1: real and imaginary parts from ``first`` on in ``twiddles``), to ``target``
    from ``to`` on, ``to_step`` floats apart."""

    @intrinsic
    def of_radix(
        typing: Any,
        source: types.Array,
        at: types.Integer,
        step: types.Integer,
        apart: types.Integer,
        target: types.Array,
        to: types.Integer,
        to_step: types.Integer,
        to_apart: types.Integer,
        twiddles: types.Array,
        first: types.Integer,
    ) -> Intrinsic:
        n = types.int64
        signature = types.void(source, n, n, n, target, n, n, n, twiddles, n)

        def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
            source, at, step, apart, target, to, to_step, to_apart, twiddles, first = arguments
            start = pointer(context, builder, signature.args[0], source, at)
            end = pointer(context, builder, signature.args[4], target, to)
            factor = pointer(context, builder, signature.args[8], twiddles, first)
            arithmetic, points = _Arithmetic(builder), []
            for j in range(radix):
                offset = builder.mul(step, ir.Constant(INDEX, j))
                points.append(tuple(load(builder, start, o) for o in (offset, builder.add(offset, apart))))
            for k, value in enumerate(arithmetic.transform(points)):
                if k:
                    places = (builder.gep(factor, [ir.Constant(INDEX, 2 * (k - 1) + part)]) for part in (0, 1))
                    value = arithmetic.product(value, [all_lanes(builder, builder.load(p)) for p in places])
                offset = builder.mul(to_step, ir.Constant(INDEX, k))
                for part, o in zip(value, (offset, builder.add(offset, to_apart)), strict=True):
                    store(builder, part, end, o)
            return context.get_dummy_value()

        return signature, generate

    return of_radix


@intrinsic
def transpose(
    typing: Any,
    source: types.Array,
    at: types.Integer,
    step: types.Integer,
    target: types.Array,
    to: types.Integer,
    to_step: types.Integer,
) -> Intrinsic:
    """Lane l of vector m (``step`` floats apart from ``at`` on in ``source``) becomes lane m of vector l (``to_step``
    floats apart from ``to`` on in ``target``)."""
    n = types.int64
    signature = types.void(source, n, n, target, n, n)

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[ir.Value]) -> ir.Value:
        source, at, step, target, to, to_step = arguments
        start = pointer(context, builder, signature.args[0], source, at)
        end = pointer(context, builder, signature.args[3], target, to)
        rows = [load(builder, start, builder.mul(step, ir.Constant(INDEX, k))) for k in range(LANES)]
        lanes = range(LANES)
        for bit in (8, 4, 2, 1):  # blocks above and below the diagonal change places, then blocks of these
            upper = [LANES + c - bit if c & bit else c for c in lanes]
            lower = [LANES + c if c & bit else c + bit for c in lanes]
            masks = [ir.Constant(ir.VectorType(LANE, LANES), mask) for mask in (upper, lower)]
            for k in lanes:
                if not k & bit:
                    pair = rows[k], rows[k + bit]
                    rows[k], rows[k + bit] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        for k, row in enumerate(rows):
            store(builder, row, end, builder.mul(to_step, ir.Constant(INDEX, k)))
        return context.get_dummy_value()

    return signature, generate
