"""The memory of arrays that kernels make: blocks that are kept, listed by their size.

An object's frame makes 130 arrays, most of them of some kilobytes. The C library has only blocks of up to one
kilobyte at hand; for others it looks for a gap, cuts it, and joins gaps again, and what it has to read for
that lies all over. It took an eighth of an object's process. Here the block of an array that is gone goes on
top of the list of its size, and the next array of about this size takes it, while the caches still hold it.

Numba makes arrays with an allocator of one's own (its header ``nrt_external.h``), but only array types of
one's own, too. So importing this module puts a function in the place of the one that kernels call for the
memory of an array; :mod:`mlbs_actors.compilation` does that before the first kernel is loaded.

Blocks are not given back: of each size a process keeps as many as it has needed at once. Arrays that Python
makes have nothing to do with all this.
"""

from __future__ import annotations

import ctypes
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import cfunc, types
from numba.core import runtime
from numba.core.registry import cpu_target
from numba.extending import intrinsic

__all__ = ["LARGEST"]

#: Bytes of the largest array whose block is kept. Of larger ones the C library's part does not count.
LARGEST = 2**18

_WORD = 8
#: Blocks begin where a line of the caches does, and so do their arrays. Between is a word that tells the
#: block's list, one that tells the next block in it, and Numba's own count of references.
_LINE = 64
_TO_NUMBER = 16  # from a block's begin to what is Numba's
#: Sizes up to 16 lines are multiples of a line; those up to twice as much, of two lines; and so on.
_SIZES_AN_OCTAVE = 16
_OCTAVES = (LARGEST // (_SIZES_AN_OCTAVE * _LINE)).bit_length()
#: Of the lists' words: the lock, alone in its line, and then each list's first block, by its address.
_FIRST_LIST = _LINE
_LISTS_BYTES = _FIRST_LIST + _WORD * (_SIZES_AN_OCTAVE * (_OCTAVES + 1) + 1)

# Untyped in Numba.
_in_kernels: Any = intrinsic(prefer_literal=True)
_function: Any = cfunc
_External: Any = types.ExternalFunction
_Pointer: Any = types.CPointer
_runtime: Any = runtime
_Word = ir.IntType(64)


class _Allocator(ctypes.Structure):
    """``NRT_ExternalAllocator`` of ``nrt_external.h``."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("malloc", "realloc", "free", "opaque_data")]


_allocator = _Allocator()
_lists = (ctypes.c_char * (_LISTS_BYTES + _LINE))()


def _register() -> None:
    """Tell LLVM by name what the functions below call, and refer to."""
    _runtime.rtsys.initialize(cpu_target.target_context)
    given = _runtime._nrt_python.c_helpers
    of_numba = ctypes.CFUNCTYPE(ctypes.POINTER(ctypes.c_void_p))(given["get_api"])()
    llvm.add_symbol("mlbs_new_external", of_numba[1])  # the header's second function, allocate_external
    llvm.add_symbol("mlbs_new", given["MemInfo_alloc_aligned"])
    llvm.add_symbol("mlbs_allocator", ctypes.addressof(_allocator))


_register()
_new_external = _External("mlbs_new_external", types.int64(types.int64, types.int64))
_new = _External("mlbs_new", types.int64(types.int64, types.int32))
_malloc = _External("malloc", types.int64(types.int64))


@_in_kernels
def _address_of_allocator(typing: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = ir.GlobalVariable(builder.module, _Word, "mlbs_allocator")
        return builder.ptrtoint(place, _Word)

    return types.int64(), build


@_in_kernels
def _word_at(typing: Any, address: Any) -> Any:
    """A pointer to what lies there, as a whole number."""

    def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], _Word.as_pointer())

    return _Pointer(types.int64)(types.int64), build


@_in_kernels
def _was_locked(typing: Any, lock: Any) -> Any:
    """Lock; whether somebody else holds the lock."""

    def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = builder.inttoptr(values[0], _Word.as_pointer())
        return builder.icmp_signed("!=", builder.atomic_rmw("xchg", place, _Word(1), "acquire"), _Word(0))

    return types.boolean(types.int64), build


@_in_kernels
def _unlock(typing: Any, lock: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = builder.inttoptr(values[0], _Word.as_pointer())
        builder.store_atomic(_Word(0), place, "release", _WORD)
        return context.get_dummy_value()

    return types.void(types.int64), build


@_function("int64(int64, int64)", _nrt=False, cache=True)
def _lend(size: int, lists: int) -> int:
    """Memory for so many bytes of Numba's, those of its own included; 0 if there is none."""
    step, octave = _LINE, 0
    while size + _TO_NUMBER > _SIZES_AN_OCTAVE * step:
        step, octave = 2 * step, octave + 1
    steps = (size + _TO_NUMBER + step - 1) // step
    own = lists + _FIRST_LIST + _WORD * (_SIZES_AN_OCTAVE * octave + steps)
    while _was_locked(lists):  # for some ten instructions of another thread
        pass
    block = _word_at(own)[0]
    if block != 0:
        _word_at(own)[0] = _word_at(block)[1]
    _unlock(lists)
    if block == 0:
        memory = _malloc(steps * step + _LINE)
        if memory == 0:
            return 0
        block = (memory + _LINE - 1) // _LINE * _LINE
        _word_at(block)[0] = own
    return int(block + _TO_NUMBER)


@_function("void(int64, int64)", _nrt=False, cache=True)
def _take_back(memory: int, lists: int) -> None:
    """Put a block on top of its list."""
    block = memory - _TO_NUMBER
    own = _word_at(block)[0]
    while _was_locked(lists):
        pass
    _word_at(block)[1] = _word_at(own)[0]
    _word_at(own)[0] = block
    _unlock(lists)


@_function("int64(int64, int32)", _nrt=False, cache=True)
def _new_array(size: int, alignment: int) -> int:
    """What Numba's ``NRT_MemInfo_alloc_aligned`` returns."""
    return int(_new(size, alignment) if size > LARGEST else _new_external(size, _address_of_allocator()))


def _begin() -> None:
    lend: Any = _lend
    take_back: Any = _take_back
    new_array: Any = _new_array
    first = ctypes.addressof(_lists)
    _allocator.malloc, _allocator.free = lend.address, take_back.address
    _allocator.opaque_data = -(-first // _LINE) * _LINE
    llvm.add_symbol("NRT_MemInfo_alloc_aligned", new_array.address)
    # An array can outlive every module when Python ends: what gives its memory back may not end before it.
    for needed in (_allocator, _lists, lend, take_back, new_array, cpu_target.target_context):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(needed))


_begin()
