"""Numbers side by side in one vector register, for kernels of many short rows.

LLVM puts a loop into vector registers by itself, but it asks before each whether what is written overlaps
what is read, gives up where too many rows are read, and does what is left over of a short row one by one.
With these types a kernel tells itself what is done side by side, and what is in between stays in registers.
Each operation is that of IEEE 754 in every lane: the result is that of a loop over single numbers.

In kernels, lanes of the same count can be added, subtracted, multiplied and divided.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

__all__ = [
    "Lanes",
    "larger",
    "load",
    "magnitude",
    "nearest_whole",
    "power_of_two",
    "root",
    "shifted",
    "smaller",
    "spread",
    "spread_lane",
    "store",
    "total",
    "whole_part",
]

#: Numbers of lanes that there are: half a register of the widest kind, and one.
COUNTS = (8, 16)

#: Decorator of a function that only kernels can call: it tells its result's type, and makes its instructions.
_in_kernels: Any = intrinsic(prefer_literal=True)

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
#: Makes the instructions, from Numba's context, LLVM's builder, the signature and the values.
_Build = Callable[[Any, Any, Any, Any], Any]


class Lanes(types.Type):
    """Numba's type of some float32 side by side."""

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Lanes({count})")
        self.count = count


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, ir.VectorType(_FLOAT, lanes.count))  # type: ignore[no-untyped-call]


def _use(operation: Callable[..., Any], instruction: str) -> None:
    """Let kernels use an operator on lanes."""

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
    """Some numbers of a flat array, float32 or uint8, from a place (uint64) on; there must be as many."""
    lanes = Lanes(count.literal_value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        kind = called.args[0]
        item = context.get_data_type(kind.dtype)
        place = _place(context, builder, kind, values[0], values[1], ir.VectorType(item, lanes.count))
        numbers = builder.load(place, align=kind.dtype.bitwidth // 8)
        if kind.dtype is types.uint8:
            return builder.uitofp(numbers, ir.VectorType(_FLOAT, lanes.count))
        return numbers

    return lanes(array, types.uint64, count), build


@_in_kernels
def store(typing: Any, array: Any, at: Any, lanes: Any) -> Any:
    """Write lanes into a flat array of float32 from a place (uint64) on; there must be room for all."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        array, at, numbers = values
        builder.store(numbers, _place(context, builder, called.args[0], array, at, numbers.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, lanes), build


def _place(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: ir.VectorType) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


@_in_kernels
def spread(typing: Any, value: Any, count: Any) -> Any:
    """The same float32 in all lanes."""
    lanes = Lanes(count.literal_value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        nothing = ir.Constant(ir.VectorType(_FLOAT, lanes.count), ir.Undefined)
        first = builder.insert_element(nothing, values[0], ir.Constant(_INT, 0))
        return _taken(builder, first, first, [0] * lanes.count)

    return lanes(types.float32, count), build


@_in_kernels
def spread_lane(typing: Any, value: Any, lane: Any) -> Any:
    """One lane's number in all of them."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return _taken(builder, values[0], values[0], [lane.literal_value] * value.count)

    return value(value, lane), build


@_in_kernels
def shifted(typing: Any, one: Any, other: Any, lanes: Any) -> Any:
    """The first lanes of two side by side after so many."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        first = lanes.literal_value
        return _taken(builder, values[0], values[1], range(first, first + one.count))

    return one(one, other, lanes), build


@_in_kernels
def total(typing: Any, value: Any) -> Any:
    """Sum of all lanes: of every fourth one after the other, then of these four by pairs."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        numbers = values[0]
        sums = _taken(builder, numbers, numbers, range(4))
        for first in range(4, value.count, 4):
            sums = builder.fadd(sums, _taken(builder, numbers, numbers, range(first, first + 4)))
        one, two, three, four = (builder.extract_element(sums, ir.Constant(_INT, i)) for i in range(4))
        return builder.fadd(builder.fadd(one, two), builder.fadd(three, four))

    return types.float32(value), build


def _taken(builder: Any, one: Any, other: Any, places: Sequence[int]) -> Any:
    """Those lanes of two side by side."""
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(_INT, len(places)), list(places)))


def _of_each(name: str) -> _Build:
    """Build LLVM's function of this name, of one or two numbers, in each lane."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        kind = values[0].type
        function = builder.module.declare_intrinsic(
            f"llvm.{name}.v{kind.count}f32", (), ir.FunctionType(kind, [kind] * len(values))
        )
        return builder.call(function, values)

    return build


@_in_kernels
def root(typing: Any, value: Any) -> Any:
    """Square roots."""
    return value(value), _of_each("sqrt")


@_in_kernels
def magnitude(typing: Any, value: Any) -> Any:
    """Absolute values."""
    return value(value), _of_each("fabs")


@_in_kernels
def larger(typing: Any, one: Any, other: Any) -> Any:
    """The larger ones of two numbers."""
    return one(one, other), _of_each("maxnum")


@_in_kernels
def smaller(typing: Any, one: Any, other: Any) -> Any:
    """The smaller ones of two numbers, the second of a pair of which one is NaN: a single instruction."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return one(one, other), build


@_in_kernels
def whole_part(typing: Any, value: Any) -> Any:
    """Numbers rounded towards 0."""
    return value(value), _of_each("trunc")


@_in_kernels
def nearest_whole(typing: Any, value: Any) -> Any:
    """Numbers rounded to the nearest whole one, halves to the even one."""
    return value(value), _of_each("rint")


@_in_kernels
def power_of_two(typing: Any, exponent: Any) -> Any:
    """Two to the power of whole numbers from -126 to 127: a float's bits hold its exponent."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        whole = ir.VectorType(_INT, exponent.count)
        bits = builder.add(builder.fptosi(values[0], whole), ir.Constant(whole, [127] * exponent.count))
        bits = builder.shl(bits, ir.Constant(whole, [23] * exponent.count))
        return builder.bitcast(bits, values[0].type)

    return exponent(exponent), build
