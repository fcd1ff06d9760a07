"""Polygons as operators write them: our own way, or copied out of another program."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

__all__ = ["read_polygon"]

_EXAMPLE = (
    "write [[0, 0.5], [1, 0.5], [1, 1]] in shares of width and height, [[0, 240], [640, 240], [640, 480]] in "
    'px, "0%,50% 100%,50% 100%,100%", or "0,0.5,1,0.5,1,1"'
)

_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)(%?)")
_TEXT = re.compile(rf"\s*{_NUMBER.pattern}(?:[\s,;]+{_NUMBER.pattern})*\s*")


def read_polygon(written: Any) -> Any:
    """Return the points, shares or px, of what may be written in several ways.

    Parameters
    ----------
    written
        A list of pairs, or of mappings with ``x`` and ``y``; numbers one after the other, in a list or a
        text; all of them with ``%``, or none. Anything else that is a list is returned as it is.

    Raises
    ------
    ValueError
        If a text is not understood.
    """
    if isinstance(written, str):
        return _pairs(_numbers(written))
    if not isinstance(written, Sequence) or not written:
        return written
    if all(isinstance(point, dict) and point.keys() == {"x", "y"} for point in written):
        written = [[point["x"], point["y"]] for point in written]
    if all(isinstance(point, str | int | float) and not isinstance(point, bool) for point in written):
        return _pairs(_numbers(",".join(map(str, written))))
    pairs = [point for point in written if isinstance(point, Sequence) and len(point) == 2]
    if len(pairs) == len(written) and any(isinstance(value, str) for pair in pairs for value in pair):
        return _pairs(_numbers(",".join(str(value) for pair in pairs for value in pair)))
    return written


def _numbers(text: str) -> list[float]:
    if _TEXT.fullmatch(text) is None:
        raise ValueError(f"this is no polygon; {_EXAMPLE}")
    found = _NUMBER.findall(text)
    percent = {sign for number, sign in found if sign or float(number) != 0}  # 0 is 0 %
    if len(percent) > 1:
        raise ValueError(f"some of the numbers have a %, some have none; {_EXAMPLE}")
    whole = 100 if percent == {"%"} else 1
    numbers = [float(number) / whole for number, _ in found]
    if whole == 100 and max(numbers) > 1:
        raise ValueError("more than 100% lies outside the picture")
    return numbers


def _pairs(numbers: list[float]) -> list[list[float]]:
    if len(numbers) % 2:
        raise ValueError(f"these are {len(numbers)} numbers, but each point needs two; {_EXAMPLE}")
    return [list(pair) for pair in zip(numbers[::2], numbers[1::2], strict=True)]
