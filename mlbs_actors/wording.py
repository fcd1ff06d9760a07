"""Numbers and values in messages."""

from __future__ import annotations

__all__ = ["count_of", "described"]


def count_of(number: int, noun: str) -> str:
    """Write ``1 frame`` or ``2 frames``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def described(value: object) -> str:
    """Write what a caller's function has returned: the shape and dtype of an array, or the type."""
    if isinstance(value, (tuple, list)):
        return f"a {type(value).__name__} of {len(value)}"
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"{tuple(shape)} {dtype}"
    return "None" if value is None else f"a {type(value).__name__}"
