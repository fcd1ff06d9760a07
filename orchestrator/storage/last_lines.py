"""The last lines of a file that grows, read from its end."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["last_lines"]


def last_lines(path: Path, most: int, line_bytes: int) -> list[str]:
    """Return the last whole lines of a text file, at most so many; none if it cannot be read.

    Parameters
    ----------
    path : Path
    most : int
    line_bytes : int
        The most that a line takes, well measured: of longer ones there can be fewer.
    """
    try:
        with path.open("rb") as file:
            begin = max(file.seek(0, os.SEEK_END) - most * line_bytes, 0)
            file.seek(begin)
            lines = file.read().split(b"\n")
    except OSError:
        return []
    # Not the first one, which was cut off, nor the last one, which is empty or being written.
    whole = lines[bool(begin) : -1]
    return [line.decode(errors="replace") for line in whole[-most:]]
