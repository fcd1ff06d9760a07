"""Numbers side by side in one vector register, for kernels of many short rows.

LLVM puts a loop into vector registers by itself, but it asks before each whether what is written overlaps
what is read, gives up where too many rows are read, and does what is left over of a short row one by one.
With these types a kernel tells itself what is done side by side, and what is in between stays in registers.
Each operation is that of IEEE 754 in every lane: the result is that of a loop over single numbers.

In kernels, lanes of the same kind and count can be added, subtracted and multiplied, and those of float32
divided.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

__all__ = [
    "Lanes",
    "cut_off",
    "larger",
    "load",
    "load_whole",
    "magnitude",
    "root",
    "spread",
    "store",
    "total",
]

#: Numbers of lanes that there are: half a register of the widest kind, and one.
COUNTS = (8, 16)

#: Decorator of a function that only kernels can call: it tells its result's type, and makes its instructions.
_in_kernels: Any = intrinsic(prefer_literal=True)

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_ITEMS: dict[Any, Any] = {types.float32: _FLOAT, types.int32: _INT}
_WIDENED: dict[Any, str] = {
    (types.uint8, types.float32): "uitofp",
    (types.uint8, types.int32): "zext",
    (types.int16, types.int32): "sext",
}
#: Makes the instructions, from Numba's context, LLVM's builder, the signature and the values.
_Build = Callable[[Any, Any, Any, Any], Any]


class Lanes(types.Type):
    """Numba's type of some float32 or int32 side by side."""

    def __init__(self, count: int, kind: types.Type) -> None:
        super().__init__(name=f"Lanes({count}, {kind})")
        self.count, self.kind = count, kind


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, _register(lanes))  # type: ignore[no-untyped-call]


def _register(lanes: Lanes) -> ir.VectorType:
    return ir.VectorType(_ITEMS[lanes.kind], lanes.count)


def _use(operation: Callable[..., Any], of_floats: str, of_ints: str | None = None) -> None:
    """Let kernels use an operator on lanes."""
    instructions: dict[Any, str | None] = {types.float32: of_floats, types.int32: of_ints}

    @_in_kernels
    def each(typing: Any, one: Any, other: Any) -> Any:
        def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
            return getattr(builder, str(instructions[one.kind]))(*values)

        return one(one, other), build

    def of_lanes(one: Any, other: Any) -> Any:
        return each(one, other)

    @overload(operation, inline="always")
    def known(one: Any, other: Any) -> Any:
        return of_lanes if isinstance(one, Lanes) and one == other and instructions[one.kind] else None


_use(operator.add, "fadd", "add")
_use(operator.sub, "fsub", "sub")
_use(operator.mul, "fmul", "mul")
_use(operator.truediv, "fdiv")


@_in_kernels
def load(typing: Any, array: Any, at: Any, count: Any) -> Any:
    """Some numbers of a flat array, float32 or uint8, from a place (uint64) on; there must be as many."""
    return _loaded(Lanes(count.literal_value, types.float32), array, count)


@_in_kernels
def load_whole(typing: Any, array: Any, at: Any, count: Any) -> Any:
    """The same of an array of uint8 or int16, as int32."""
    return _loaded(Lanes(count.literal_value, types.int32), array, count)


def _loaded(lanes: Lanes, array: Any, count: Any) -> Any:
    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        vector = ir.VectorType(context.get_data_type(array.dtype), lanes.count)
        place = _place(context, builder, array, values[0], values[1], vector)
        numbers = builder.load(place, align=array.dtype.bitwidth // 8)
        if array.dtype is lanes.kind:
            return numbers
        return getattr(builder, _WIDENED[array.dtype, lanes.kind])(numbers, _register(lanes))

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
    """The same float32 or int32 in all lanes."""
    lanes = Lanes(count.literal_value, value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        nothing = ir.Constant(_register(lanes), ir.Undefined)
        first = builder.insert_element(nothing, values[0], ir.Constant(_INT, 0))
        places = ir.Constant(ir.VectorType(_INT, lanes.count), [0] * lanes.count)
        return builder.shuffle_vector(first, nothing, places)

    return lanes(value, count), build


@_in_kernels
def cut_off(typing: Any, value: Any) -> Any:
    """float32 without what is behind the point, as int32."""
    whole = Lanes(value.count, types.int32)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return builder.fptosi(values[0], _register(whole))

    return whole(value), build


@_in_kernels
def total(typing: Any, value: Any) -> Any:
    """Sum of all lanes of int32."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        kind = values[0].type
        function = builder.module.declare_intrinsic(
            f"llvm.vector.reduce.add.v{kind.count}i32", (), ir.FunctionType(_INT, [kind])
        )
        return builder.call(function, values)

    return types.int32(value), build


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
