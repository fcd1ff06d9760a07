"""Pickling of small messages between processes by their values.

Python pickles a frozen dataclass with slots by functions that look up its fields anew for each instance,
which is costly in a process that wakes for a millisecond a frame.
"""

from __future__ import annotations

import copyreg
from dataclasses import fields
from operator import attrgetter
from typing import Any, TypeVar

__all__ = ["pickled_by_values"]

Class = TypeVar("Class", bound=type[Any])


def pickled_by_values(cls: Class) -> Class:
    """Decorate a dataclass of two or more fields to pickle its instances as calls with their values."""
    values = attrgetter(*(field.name for field in fields(cls)))
    copyreg.pickle(cls, lambda message: (cls, values(message)))
    return cls
