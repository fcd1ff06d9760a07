"""The part of a stream that something is made of: ``--from`` and ``--to``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from mlbs_actors.errors import ConfigError

__all__ = ["ALL", "Moment", "Span", "clock", "parse_moment"]

_TIME = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d*)?)")
_FRAME = re.compile(r"(\d+)f")


@dataclass(frozen=True, slots=True)
class Moment:
    """A place in a stream: a time since its first frame, s, or the number of a frame."""

    seconds: float | None = None
    frame: int | None = None

    def is_after(self, frame: int, pts: float) -> bool:
        """Whether a frame comes before this moment."""
        return frame < self.frame if self.frame is not None else pts < (self.seconds or 0.0)


@dataclass(frozen=True, slots=True)
class Span:
    """The frames from one moment on and before another."""

    begin: Moment = Moment(frame=0)
    end: Moment | None = None

    def is_ahead(self, frame: int, pts: float) -> bool:
        """Whether it begins after a frame."""
        return self.begin.is_after(frame, pts)

    def is_over(self, frame: int, pts: float) -> bool:
        """Whether it ends before a frame."""
        return self.end is not None and not self.end.is_after(frame, pts)

    def holds(self, frame: int, pts: float) -> bool:
        """Whether a frame is in it."""
        return not self.is_ahead(frame, pts) and not self.is_over(frame, pts)


ALL = Span()


def parse_moment(text: str) -> Moment:
    """Read ``12.5`` or ``1:02.5`` (a time) or ``300f`` (a frame); raises ConfigError."""
    if match := _FRAME.fullmatch(text):
        return Moment(frame=int(match[1]))
    if match := _TIME.fullmatch(text):
        hours, minutes, seconds = match.groups(default="0")
        return Moment(seconds=int(hours) * 3600 + int(minutes) * 60 + float(seconds))
    raise ConfigError(
        f"{text!r} is no moment of a video; write seconds, such as 12.5, a time such as 1:02.5, or the "
        "number of a frame with an f, such as 300f."
    )


def clock(seconds: float) -> str:
    """Write a time, s, as ``h:mm:ss.mmm``."""
    thousandths = round(seconds * 1000)
    return (
        f"{thousandths // 3_600_000}:{thousandths // 60_000 % 60:02d}:"
        f"{thousandths // 1000 % 60:02d}.{thousandths % 1000:03d}"
    )
