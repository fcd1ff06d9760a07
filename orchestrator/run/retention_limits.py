"""``--segment`` and ``--keep`` as they are written on the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from mlbs_actors.errors import ConfigError

__all__ = ["Keep", "parse_keep", "parse_segment", "segment_with"]

_HOUR = 3600  # s
_SEGMENTS = {"hour": _HOUR, "day": 24 * _HOUR}
_AGES = {"m": 60, "h": _HOUR, "d": 24 * _HOUR, "w": 7 * 24 * _HOUR}
_SIZES = {"MB": 10**6, "GB": 10**9, "TB": 10**12, "MiB": 2**20, "GiB": 2**30, "TiB": 2**40}


@dataclass(frozen=True, slots=True)
class Keep:
    """How much of the cameras' record is kept.

    Attributes
    ----------
    seconds : int, optional
        Greatest age.
    size : int, optional
        Of all cameras together, bytes.
    words : tuple of str
        As they were given.
    """

    seconds: int | None = None
    size: int | None = None
    words: tuple[str, ...] = ()


def segment_with(segment: int | None, keep: Keep | None) -> int | None:
    """Return the length of segments, s, if so much is kept: whole segments are deleted, by default hours."""
    return _HOUR if segment is None and keep is not None else segment


def parse_segment(text: str) -> int:
    """Read ``hour``, ``day`` or a number of seconds."""
    if text in _SEGMENTS:
        return _SEGMENTS[text]
    if not (text.isascii() and text.isdecimal() and int(text) > 0):
        raise ConfigError(f"--segment takes hour, day or a whole number of seconds, not {text!r}.")
    return int(text)


def parse_keep(texts: Sequence[str]) -> Keep:
    """Read an age, such as ``7d``, a size, such as ``50GB``, or both."""
    seconds = size = None
    for text in texts:
        found = re.fullmatch(r"(\d+(?:\.\d+)?) ?([A-Za-z]+)", text)
        amount, unit = (float(found[1]), found[2]) if found else (0.0, "")
        if amount > 0 and unit in _AGES and seconds is None:
            seconds = round(amount * _AGES[unit])
        elif amount > 0 and unit in _SIZES and size is None:
            size = round(amount * _SIZES[unit])
        else:
            raise ConfigError(
                f"--keep takes an age in {', '.join(_AGES)}, such as 7d, or a size in {', '.join(_SIZES)}, "
                f"such as 50GB, each of them once; not {text!r}."
            )
    return Keep(seconds, size, tuple(texts))
