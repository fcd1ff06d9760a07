"""How long a run will take, told before its rate is known: a range, as measured on other machines."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from itertools import pairwise

from mlbs_actors.wording import count_of
from orchestrator.sources.survey import SourceContent

__all__ = ["expected_seconds", "words_on_expected_time"]

#: CPU time of a frame by its number of pixels, ms, with one object and with sixteen: docs/scaling.md.
_CPU_MS = (
    (640 * 480, 28.3, 75.2),
    (1280 * 720, 48.9, 127.5),
    (1920 * 1080, 110.1, 193.1),
    (3840 * 2160, 273.9, 490.7),
)

#: Units of time, s.
_UNITS = (("hour", 3600), ("minute", 60), ("second", 1))

#: How much slower a machine may be than the one measured, whose cores others use too.
_SLOWER = 2.0

#: Cores that the processes of one stream keep busy at most.
_CORES_A_STREAM = 2


def words_on_expected_time(
    contents: Sequence[SourceContent], cores: int, max_frames: int | None, max_side: int | None
) -> str | None:
    """Say how many frames there are and how long they take, or None if no number of frames is known.

    Parameters
    ----------
    contents : sequence of SourceContent
        Of all files that are to be read.
    cores : int
        Of this machine.
    max_frames, max_side : int, optional
        Limits of the command.
    """
    known = [one for one in contents if one.length is not None and one.size is not None]
    if not known:
        return None
    frames = sum(_frames(one, max_frames) for one in known)
    least, most = expected_seconds(known, cores, max_frames, max_side)
    of = count_of(len(known), "file") + (" of known length" if len(known) < len(contents) else "")
    return (
        f"{of}, {frames:,} {'frame' if frames == 1 else 'frames'}: {_range(least, most)} once running "
        "(an estimate from other machines)."
    )


def expected_seconds(
    contents: Sequence[SourceContent], cores: int, max_frames: int | None = None, max_side: int | None = None
) -> tuple[float, float]:
    """Return the least and the most time that files take, s; parameters as above."""
    busy = min(cores, _CORES_A_STREAM * len(contents))
    least = most = 0.0
    for one in contents:
        low, high = _cpu_ms(_pixels(one, max_side))
        least += low * _frames(one, max_frames) / 1000
        most += high * _frames(one, max_frames) / 1000
    return least / busy, most * _SLOWER / busy


def _frames(content: SourceContent, most: int | None) -> int:
    return min(content.length or 0, most or sys.maxsize)


def _pixels(content: SourceContent, max_side: int | None) -> float:
    height, width = content.size or (0, 0)
    shrunk = 1.0 if max_side is None else min(max_side / max(height, width, 1), 1.0)
    return height * width * shrunk**2


def _cpu_ms(pixels: float) -> tuple[float, float]:
    """Interpolate between the sizes that were measured; beyond them time is in proportion to the pixels."""
    first, last = _CPU_MS[0], _CPU_MS[-1]
    if not first[0] < pixels < last[0]:
        nearest = first if pixels <= first[0] else last
        return nearest[1] * pixels / nearest[0], nearest[2] * pixels / nearest[0]
    below, above = next(pair for pair in pairwise(_CPU_MS) if pixels < pair[1][0])
    part = (pixels - below[0]) / (above[0] - below[0])
    return below[1] + part * (above[1] - below[1]), below[2] + part * (above[2] - below[2])


def _range(least: float, most: float) -> str:
    """Write a range of times in one unit."""
    unit, seconds = next((one for one in _UNITS if most >= 2 * one[1]), _UNITS[-1])
    low, high = math.floor(least / seconds), math.ceil(most / seconds)
    return f"about {low} to {count_of(high, unit)}" if low else f"up to {count_of(high, unit)}"
