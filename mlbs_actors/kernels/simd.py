"""Explicit SIMD: float32 lanes of one vector register, for kernels of many short rows.

LLVM vectorises loops by itself, but first tests at run time whether outputs overlap inputs, gives up where
too many rows are read, and processes the rest of a short row one by one. With these types a kernel states
itself what is done in parallel, and intermediate values stay in registers. Each operation is that of IEEE 754
in every lane, so the result is that of a scalar loop. Only :func:`multiply_add` can depend on the processor,
by its last bit.

In kernels, lanes of the same count can be added, subtracted, multiplied and divided. Any other call, such as
on an array that is not flat and contiguous, does not compile.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

__all__ = [
    "LANES",
    "Lanes",
    "absolute",
    "broadcast",
    "exp2_of_whole",
    "load",
    "maximum",
    "minimum",
    "multiply_add",
    "rounded",
    "square_root",
    "store",
    "sum_of_lanes",
    "truncated",
]

#: The two lane counts: half a register of the widest kind, and a whole one.
COUNTS = (8, 16)
#: Lanes of a register of the widest kind: rows are processed in steps of this.
LANES = 16

#: Decorator of a function that only kernels can call: it returns the result's type and a builder of its
#: instructions, or None if the arguments do not fit.
_in_kernels: Any = intrinsic(prefer_literal=True)

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
#: Element types that lanes are loaded from, and the instruction that converts them to float32.
_WIDENED: dict[Any, str | None] = {types.float32: None, types.uint8: "uitofp", types.int16: "sitofp"}
#: Builds the instructions, from Numba's context, LLVM's builder, the signature and the values.
_Build = Callable[[Any, Any, Any, Any], Any]


class Lanes(types.Type):
    """Numba's type of some float32 lanes."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Lanes({count})")
        self.count = count


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, _register(lanes))  # type: ignore[no-untyped-call]


def _register(lanes: Lanes) -> ir.VectorType:
    return ir.VectorType(_FLOAT, lanes.count)


def _use(operation: Callable[..., Any], instruction: str) -> None:
    """Define an operator on lanes in kernels."""

    @_in_kernels
    def each(typing: Any, one: Any, other: Any) -> Any:
        def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
            return getattr(builder, instruction)(*values)

        return one(one, other), build

    def of_lanes(one: Any, other: Any) -> Any:
        return each(one, other)

    @overload(operation, inline="always")
    def known(one: Any, other: Any) -> Any:
        return of_lanes if isinstance(one, Lanes) and one == other else None


_use(operator.add, "fadd")
_use(operator.sub, "fsub")
_use(operator.mul, "fmul")
_use(operator.truediv, "fdiv")


@_in_kernels
def load(typing: Any, array: Any, at: Any, count: Any) -> Any:
    """Load lanes from an array of float32, int16 or uint8 at an index (uint64); it must have as many."""
    if not (_is_flat(array) and _is_count(count) and array.dtype in _WIDENED):
        return None
    lanes, widened = Lanes(count.literal_value), _WIDENED[array.dtype]

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        vector = ir.VectorType(context.get_data_type(array.dtype), lanes.count)
        place = _place(context, builder, array, values[0], values[1], vector)
        numbers = builder.load(place, align=array.dtype.bitwidth // 8)
        return numbers if widened is None else getattr(builder, widened)(numbers, _register(lanes))

    return lanes(array, types.uint64, count), build


@_in_kernels
def store(typing: Any, array: Any, at: Any, lanes: Any) -> Any:
    """Store lanes into an array of float32 at an index (uint64); there must be room for all."""
    if (
        not (_is_flat(array) and array.mutable and isinstance(lanes, Lanes))
        or array.dtype is not types.float32
    ):
        return None

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        array, at, numbers = values
        builder.store(numbers, _place(context, builder, called.args[0], array, at, numbers.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, lanes), build


def _is_flat(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _is_count(count: Any) -> bool:
    return isinstance(count, types.IntegerLiteral) and count.literal_value in COUNTS


def _place(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: ir.VectorType) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


@_in_kernels
def broadcast(typing: Any, value: Any, count: Any) -> Any:
    """Copy one float32 to all lanes."""
    if not (value is types.float32 and _is_count(count)):
        return None
    lanes = Lanes(count.literal_value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        nothing = ir.Constant(_register(lanes), ir.Undefined)
        first = builder.insert_element(nothing, values[0], ir.Constant(_INT, 0))
        return _taken(builder, first, first, [0] * lanes.count)

    return lanes(value, count), build


@_in_kernels
def sum_of_lanes(typing: Any, value: Any) -> Any:
    """Sum all lanes: every fourth one sequentially, then these four by pairs."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        numbers, add = values[0], builder.fadd
        sums = _taken(builder, numbers, numbers, range(4))
        for first in range(4, value.count, 4):
            sums = add(sums, _taken(builder, numbers, numbers, range(first, first + 4)))
        one, two, three, four = (builder.extract_element(sums, ir.Constant(_INT, i)) for i in range(4))
        return add(add(one, two), add(three, four))

    return types.float32(value), build


def _taken(builder: Any, one: Any, other: Any, places: Sequence[int]) -> Any:
    """Select lanes of two vectors."""
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(_INT, len(places)), list(places)))


def _of_each(name: str) -> _Build:
    """Build LLVM's function of this name, of one or two arguments, in each lane."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        kind = values[0].type
        function = builder.module.declare_intrinsic(
            f"llvm.{name}.v{kind.count}f32", (), ir.FunctionType(kind, [kind] * len(values))
        )
        return builder.call(function, values)

    return build


@_in_kernels
def square_root(typing: Any, value: Any) -> Any:
    """Take square roots."""
    return value(value), _of_each("sqrt")


@_in_kernels
def absolute(typing: Any, value: Any) -> Any:
    """Take absolute values."""
    return value(value), _of_each("fabs")


@_in_kernels
def multiply_add(typing: Any, one: Any, other: Any, added: Any) -> Any:
    """Multiply and add, rounded once where the processor can."""
    return one(one, other, added), _of_each("fmuladd")


@_in_kernels
def maximum(typing: Any, one: Any, other: Any) -> Any:
    """Return the larger of two numbers; if one is NaN, the other."""
    return one(one, other), _of_each("maxnum")


@_in_kernels
def minimum(typing: Any, one: Any, other: Any) -> Any:
    """Return the smaller of two numbers; if one is NaN, the second: a single instruction."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return one(one, other), build


@_in_kernels
def truncated(typing: Any, value: Any) -> Any:
    """Round towards 0."""
    return value(value), _of_each("trunc")


@_in_kernels
def rounded(typing: Any, value: Any) -> Any:
    """Round to the nearest integer, halves to even."""
    return value(value), _of_each("rint")


@_in_kernels
def exp2_of_whole(typing: Any, exponent: Any) -> Any:
    """Raise two to integers from -126 to 127, by the bits of the exponent."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        whole = ir.VectorType(_INT, exponent.count)
        bits = builder.add(builder.fptosi(values[0], whole), ir.Constant(whole, [127] * exponent.count))
        bits = builder.shl(bits, ir.Constant(whole, [23] * exponent.count))
        return builder.bitcast(bits, values[0].type)

    return exponent(exponent), build
