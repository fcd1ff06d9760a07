"""The state of a part as a file, or sent to another process: typed arrays and plain values, no pickle.

A file holds one dataclass: its values as JSON, in which an array is a number, then the bytes of the arrays,
then the CRC-32 of all that. It is read against the expected type, field by field; a mismatch is refused, and
nothing in a file can name code.

Besides their values, arrays keep their memory order and whether they may be written to: sums and compiled
kernels depend on them.
"""

from __future__ import annotations

import functools
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from mlbs_actors.errors import SnapshotError
from mlbs_actors.messages import Array

__all__ = ["CapturedState", "capture", "check_file", "read_state"]

_State = TypeVar("_State")

#: First bytes of every file; they change with the format.
_MAGIC = b"mlbs-st1"
_LENGTH = struct.Struct("<Q")
_CHECKSUM = struct.Struct("<I")
_ALIGNMENT = 64
_SCALARS = (bool, int, float, str)


@dataclass(frozen=True, slots=True)
class CapturedState:
    """A copy of a state at one moment.

    Attributes
    ----------
    header : bytes
    arrays : tuple of (n,) uint8
        Their bytes, as they are in the file.
    """

    header: bytes
    arrays: tuple[Array, ...]

    def state(self, kind: type[_State]) -> _State:
        """Rebuild the state for another process; all arrays are copies.

        Parameters
        ----------
        kind : type
            The dataclass that was captured.
        """
        header = json.loads(self.header)
        arrays = [_formed(array, one) for array, one in zip(self.arrays, header["arrays"], strict=True)]
        state: _State = _decoded(header["values"], kind, arrays)
        return state

    def write(self, path: Path) -> None:
        """Write the file and wait until it is on the disk; under its name it is always complete.

        Raises
        ------
        OSError
            As the disk says.
        """
        draft = path.with_name(f".{path.name}.part")
        checksum = 0
        with draft.open("wb") as file:
            for piece in self._pieces():
                checksum = zlib.crc32(piece, checksum)
                file.write(piece)
            file.write(_CHECKSUM.pack(checksum))
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)

    def _pieces(self) -> Iterator[bytes | memoryview]:
        position = len(_MAGIC) + _LENGTH.size + len(self.header)
        yield _MAGIC + _LENGTH.pack(len(self.header)) + self.header
        for array in self.arrays:
            padding = -position % _ALIGNMENT
            yield b"\0" * padding
            yield array.data
            position += padding + array.nbytes


def capture(state: object) -> CapturedState:
    """Copy a state, so that it can be written while its part goes on.

    Parameters
    ----------
    state : dataclass
        Of arrays, bool, int, float, str, None, tuples, mappings and further dataclasses, as its annotations
        say.

    Raises
    ------
    TypeError
        If a value does not match its annotation and could not be read back.
    """
    arrays: list[Array] = []
    values = _encoded(state, type(state), arrays)
    header = json.dumps({"kind": type(state).__name__, "values": values, "arrays": _layout(arrays)})
    copies = (array.copy(order="A").reshape(-1, order="A").view(np.uint8) for array in arrays)
    return CapturedState(header.encode(), tuple(copies))


def read_state(path: Path, kind: type[_State]) -> _State:
    """Read a file back.

    Parameters
    ----------
    path : Path
    kind : type
        The dataclass that it must hold.

    Raises
    ------
    SnapshotError
        If the file is missing, damaged, or holds another type.
    """
    content = _checked(path)
    try:
        start = len(_MAGIC) + _LENGTH.size
        (length,) = _LENGTH.unpack_from(content.data, len(_MAGIC))
        header = json.loads(content[start : start + length].tobytes())
        if header["kind"] != kind.__name__:
            raise ValueError(f"it holds a {header['kind']}")
        arrays = _arrays(content, start + length, header["arrays"])
        state: _State = _decoded(header["values"], kind, arrays)
    except (ValueError, KeyError, TypeError, struct.error) as error:
        raise SnapshotError(f"The state {path} is not one of this version ({error}).") from None
    return state


def check_file(path: Path) -> None:
    """Check that a file is complete; raises as :func:`read_state`."""
    _checked(path)


def _checked(path: Path) -> Array:
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise SnapshotError(f"The state {path} cannot be read: {error.strerror}.") from None
    body, end = content[: -_CHECKSUM.size], content[-_CHECKSUM.size :].tobytes()
    if body[: len(_MAGIC)].tobytes() != _MAGIC or _CHECKSUM.pack(zlib.crc32(body.data)) != end:
        raise SnapshotError(f"The state {path} is damaged.")
    return content


def _layout(arrays: list[Array]) -> list[dict[str, Any]]:
    return [
        {
            "dtype": array.dtype.str,
            "shape": array.shape,
            "fortran": array.flags.fnc,
            "writeable": array.flags.writeable,
        }
        for array in arrays
    ]


def _arrays(content: Array, position: int, layout: list[dict[str, Any]]) -> list[Array]:
    arrays = []
    for one in layout:
        position += -position % _ALIGNMENT
        end = position + np.dtype(one["dtype"]).itemsize * int(np.prod(one["shape"], dtype=np.int64))
        arrays.append(_formed(content[position:end], one))
        position = end
    return arrays


def _formed(content: Array, layout: Mapping[str, Any]) -> Array:
    """Copy an array from its bytes, (n,) uint8."""
    order: Literal["F", "C"] = "F" if layout["fortran"] else "C"
    array: Array = content.copy().view(np.dtype(layout["dtype"])).reshape(tuple(layout["shape"]), order=order)
    array.setflags(write=layout["writeable"])
    return array


def _encoded(value: Any, hint: Any, arrays: list[Array]) -> Any:
    """Encode a value of type ``hint`` as JSON, with its arrays appended to ``arrays``."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        (other,) = (one for one in arguments if one is not type(None))
        return None if value is None else _encoded(value, other, arrays)
    if is_dataclass(hint):
        _expect(type(value) is hint, value, hint)
        kind: Any = hint
        types = _types(kind)
        return {name: _encoded(getattr(value, name), one, arrays) for name, one in types.items()}
    if np.ndarray in (hint, origin):
        _expect(type(value) is np.ndarray and not value.dtype.hasobject, value, hint)
        arrays.append(value)
        return len(arrays) - 1
    if origin is tuple:
        _expect(type(value) is tuple, value, hint)
        return [
            _encoded(one, kind, arrays)
            for one, kind in zip(value, _member_types(arguments, len(value)), strict=True)
        ]
    if origin in (dict, Mapping):
        _expect(isinstance(value, Mapping), value, hint)
        key, member = arguments
        return [[_encoded(k, key, arrays), _encoded(v, member, arrays)] for k, v in value.items()]
    if origin is Literal:
        _expect(value in arguments, value, hint)
        return value
    _expect(hint in _SCALARS and type(value) is hint, value, hint)
    return value


def _decoded(value: Any, hint: Any, arrays: list[Array]) -> Any:
    """Decode a value of :func:`_encoded`."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        (other,) = (one for one in arguments if one is not type(None))
        return None if value is None else _decoded(value, other, arrays)
    if is_dataclass(hint):
        make: Any = hint
        types = _types(make)
        _expect(type(value) is dict and value.keys() == types.keys(), value, hint)
        return make(**{name: _decoded(value[name], one, arrays) for name, one in types.items()})
    if np.ndarray in (hint, origin):
        _expect(type(value) is int and 0 <= value < len(arrays), value, hint)
        return arrays[value]
    if origin is tuple:
        _expect(type(value) is list, value, hint)
        return tuple(
            _decoded(one, kind, arrays)
            for one, kind in zip(value, _member_types(arguments, len(value)), strict=True)
        )
    if origin in (dict, Mapping):
        _expect(type(value) is list, value, hint)
        key, member = arguments
        return {_decoded(k, key, arrays): _decoded(v, member, arrays) for k, v in value}
    if origin is Literal:
        _expect(value in arguments, value, hint)
        return value
    _expect(hint in _SCALARS and type(value) is hint, value, hint)
    return value


@functools.cache
def _types(kind: Any) -> dict[str, Any]:
    """Cache the types of a dataclass's fields, which Python evaluates anew each time."""
    types = get_type_hints(kind)
    return {one.name: types[one.name] for one in fields(kind)}


def _member_types(arguments: tuple[Any, ...], count: int) -> tuple[Any, ...]:
    """Return the types of a tuple's members: ``tuple[X, ...]`` has any number."""
    return (arguments[0],) * count if arguments[1:] == (Ellipsis,) else arguments


def _expect(holds: bool, value: object, hint: object) -> None:
    if not holds:
        raise TypeError(f"{type(value).__name__} is no {hint}")
