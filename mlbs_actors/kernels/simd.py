"""Numbers side by side in one vector register, for kernels of many short rows.

LLVM puts a loop into vector registers by itself, but it asks before each whether what is written overlaps
what is read, gives up where too many rows are read, and does what is left over of a short row one by one.
With these types a kernel tells itself what is done side by side, and what is in between stays in registers.
Each operation is that of IEEE 754 in every lane: the result is that of a loop over single numbers. Only what
:func:`multiply_add` gives can depend on the processor, by its last bit.

In kernels, lanes of the same kind and count can be added, subtracted and multiplied, and those of float32
divided. What is no such call does not compile: an array that is not flat and contiguous, say.
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
    "broadcast_lane",
    "exp2_of_whole",
    "gathered",
    "load",
    "load_int32",
    "maximum",
    "minimum",
    "multiply_add",
    "rounded",
    "shifted",
    "square_root",
    "store",
    "sum_of_lanes",
    "truncated",
    "where_equal",
]

#: Numbers of lanes that there are: half a register of the widest kind, and one.
COUNTS = (8, 16)
#: Of a register of the widest kind: so much of a row is done at once.
LANES = 16

#: Decorator of a function that only kernels can call: it tells its result's type, and makes its instructions;
#: without a type there is no such function.
_in_kernels: Any = intrinsic(prefer_literal=True)

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_ITEMS: dict[Any, Any] = {types.float32: _FLOAT, types.int32: _INT}
#: What lanes are loaded from, and the instruction that makes their kind of it.
_WIDENED: dict[Any, str | None] = {
    (types.float32, types.float32): None,
    (types.uint8, types.float32): "uitofp",
    (types.int16, types.float32): "sitofp",
    (types.uint8, types.int32): "zext",
    (types.int16, types.int32): "sext",
    (types.int32, types.int32): None,
}
#: Integers that can be gathered, and the instruction that makes int32 of them.
_GATHERED: dict[Any, str | None] = {types.int16: "sext", types.int32: None, types.int64: "trunc"}
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
    """Some numbers of an array of float32, int16 or uint8 from a place (uint64) on; there must be as many."""
    return _loaded(array, count, types.float32)


@_in_kernels
def load_int32(typing: Any, array: Any, at: Any, count: Any) -> Any:
    """The same of an array of uint8, int16 or int32, as int32."""
    return _loaded(array, count, types.int32)


@_in_kernels
def gathered(typing: Any, array: Any, places: Any) -> Any:
    """What an array of integers, which fit into int32, has at some places (int32, none of them negative)."""
    if not (_is_flat(array) and array.dtype in _GATHERED and places.kind is types.int32):
        return None
    narrowed = _GATHERED[array.dtype]

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        data = context.make_array(array)(context, builder, values[0]).data
        numbers = ir.Constant(_register(places), ir.Undefined)
        for lane in range(places.count):
            place = builder.extract_element(values[1], ir.Constant(_INT, lane))
            number = builder.load(builder.gep(data, [builder.zext(place, ir.IntType(64))]))
            if narrowed is not None:
                number = getattr(builder, narrowed)(number, _INT)
            numbers = builder.insert_element(numbers, number, ir.Constant(_INT, lane))
        return numbers

    return places(array, places), build


def _loaded(array: Any, count: Any, kind: types.Type) -> Any:
    if not (_is_flat(array) and _is_count(count) and (array.dtype, kind) in _WIDENED):
        return None
    lanes, widened = Lanes(count.literal_value, kind), _WIDENED[array.dtype, kind]

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        vector = ir.VectorType(context.get_data_type(array.dtype), lanes.count)
        place = _place(context, builder, array, values[0], values[1], vector)
        numbers = builder.load(place, align=array.dtype.bitwidth // 8)
        return numbers if widened is None else getattr(builder, widened)(numbers, _register(lanes))

    return lanes(array, types.uint64, count), build


@_in_kernels
def store(typing: Any, array: Any, at: Any, lanes: Any) -> Any:
    """Write lanes into an array of their kind from a place (uint64) on; there must be room for all."""
    if not (_is_flat(array) and array.mutable and isinstance(lanes, Lanes) and array.dtype is lanes.kind):
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
    """The same float32 or int32 in all lanes."""
    if not (value in _ITEMS and _is_count(count)):
        return None
    lanes = Lanes(count.literal_value, value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        nothing = ir.Constant(_register(lanes), ir.Undefined)
        first = builder.insert_element(nothing, values[0], ir.Constant(_INT, 0))
        return _taken(builder, first, first, [0] * lanes.count)

    return lanes(value, count), build


@_in_kernels
def broadcast_lane(typing: Any, value: Any, lane: Any) -> Any:
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
def sum_of_lanes(typing: Any, value: Any) -> Any:
    """Sum of all lanes; of float32 that of every fourth one after the other, then of these four by pairs."""
    whole = value.kind is types.int32

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        numbers, add = values[0], builder.add if whole else builder.fadd
        sums = _taken(builder, numbers, numbers, range(4))
        for first in range(4, value.count, 4):
            sums = add(sums, _taken(builder, numbers, numbers, range(first, first + 4)))
        one, two, three, four = (builder.extract_element(sums, ir.Constant(_INT, i)) for i in range(4))
        return add(add(one, two), add(three, four))

    return value.kind(value), build


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
def square_root(typing: Any, value: Any) -> Any:
    """Square roots."""
    return value(value), _of_each("sqrt")


@_in_kernels
def absolute(typing: Any, value: Any) -> Any:
    """Absolute values."""
    return value(value), _of_each("fabs")


@_in_kernels
def multiply_add(typing: Any, one: Any, other: Any, added: Any) -> Any:
    """Products of two numbers and a third one, rounded once where the processor can."""
    return one(one, other, added), _of_each("fmuladd")


@_in_kernels
def maximum(typing: Any, one: Any, other: Any) -> Any:
    """The larger ones of two numbers; of a pair of which one is NaN, the other."""
    return one(one, other), _of_each("maxnum")


@_in_kernels
def minimum(typing: Any, one: Any, other: Any) -> Any:
    """The smaller ones of two numbers, the second of a pair of which one is NaN: a single instruction."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return one(one, other), build


@_in_kernels
def where_equal(typing: Any, one: Any, other: Any, then: Any, otherwise: Any) -> Any:
    """Of two values the first where two lanes of int32 are the same, else the second."""
    if not (one == other and then == otherwise and one.kind is types.int32 and one.count == then.count):
        return None

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        return builder.select(builder.icmp_signed("==", values[0], values[1]), values[2], values[3])

    return then(one, other, then, otherwise), build


@_in_kernels
def truncated(typing: Any, value: Any) -> Any:
    """Numbers rounded towards 0."""
    return value(value), _of_each("trunc")


@_in_kernels
def rounded(typing: Any, value: Any) -> Any:
    """Numbers rounded to the nearest whole one, halves to the even one."""
    return value(value), _of_each("rint")


@_in_kernels
def exp2_of_whole(typing: Any, exponent: Any) -> Any:
    """Two to the power of whole numbers from -126 to 127: a float's bits hold its exponent."""

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        whole = ir.VectorType(_INT, exponent.count)
        bits = builder.add(builder.fptosi(values[0], whole), ir.Constant(whole, [127] * exponent.count))
        bits = builder.shl(bits, ir.Constant(whole, [23] * exponent.count))
        return builder.bitcast(bits, values[0].type)

    return exponent(exponent), build
