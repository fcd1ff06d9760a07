"""An object's compiled frame, called by its address in the process.

Called by its name, it would be compiled, and loaded, once more as a part of the kernel that calls it: 20 MB
of each object's process.
"""

from __future__ import annotations

from typing import Any

from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

from mlbs_actors.config import Config
from mlbs_actors.layer import Layer
from mlbs_actors.object_frame import ObjectView, object_frame

__all__ = ["address_of_frame", "called_at"]

# Untyped in Numba.
_in_kernels: Any = intrinsic(prefer_literal=True)
_tuple: Any = types.Tuple
_if_unlikely: Any = cgutils.if_unlikely
_unpacked: Any = cgutils.unpack_tuple
_dispatcher: Any = object_frame


def _types_of_frame() -> Any:
    layer = Layer(Config(), 1, "object")
    view = ObjectView(layer.config, 1, (480, 640))

    def shown(kind: Any, dimensions: int) -> Any:
        return types.Array(kind, dimensions, "C", readonly=True)

    return _tuple(
        (
            *map(typeof, view.constants),
            _tuple((types.uint16, types.int64, types.int64, types.int64, types.bool_)),
            _tuple(
                (
                    shown(types.uint8, 3),
                    shown(types.float32, 2),
                    shown(types.float32, 2),
                    shown(types.float64, 2),
                    shown(types.uint16, 3),
                    shown(types.bool_, 2),
                    shown(types.uint8, 2),
                    shown(types.uint8, 2),
                )
            ),
            _tuple((shown(types.uint16, 2), shown(types.uint8, 2), shown(types.int8, 2))),
            types.Array(types.float64, 1, "C"),
            *map(typeof, view.kept(layer.state)),
        )
    )


#: What :func:`~mlbs_actors.object_frame.object_frame` is given here, for Numba.
_GIVEN = _types_of_frame()


@_in_kernels
def called_at(typing: Any, address: Any, given: Any) -> Any:
    """What the compiled :func:`~mlbs_actors.object_frame.object_frame` at an address returns."""
    if given.types != _GIVEN.types:
        return None
    called: Any = types.Dispatcher(_dispatcher).get_call_type(typing, given.types, {})

    def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        convention, arguments = context.call_conv, _unpacked(builder, values[1])
        kind = convention.get_function_type(called.return_type, called.args)
        place = builder.inttoptr(values[0], kind.as_pointer())
        status, result = convention.call_function(builder, place, called.return_type, called.args, arguments)
        with _if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return result

    return called.return_type(address, given), build


def address_of_frame() -> int:
    """Where :func:`~mlbs_actors.object_frame.object_frame` is in this process, for what it is given here."""
    made = _dispatcher.overloads[_GIVEN.types]  # since a frame was done through Python
    address = int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))
    assert address
    return address
