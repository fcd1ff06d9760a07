"""What the pictures of a run show: of overlays, of the monitor, of events."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

from orchestrator.option_values import DRAWABLE

__all__ = ["DEFAULT_DRAWING", "Drawing"]


@dataclass(frozen=True, slots=True)
class Drawing:
    """What is drawn over pictures beside the tints and outlines of objects, and whether what moves is hidden.

    Attributes
    ----------
    ids, zones : bool
        Of objects; outlines with their names.
    frame : bool
        Its number, in the overlay and the monitor's pictures.
    clock : bool
        The time there: of a camera that of the day, else that in the stream. Pictures of events always have
        it.
    time_zone : str, optional
        IANA name; that of this machine without.
    private : bool
        Whether what moves is blurred.
    """

    ids: bool = True
    zones: bool = True
    frame: bool = True
    clock: bool = False
    time_zone: str | None = None
    private: bool = False

    @classmethod
    def of(cls, drawn: Collection[str], time_zone: str | None, *, private: bool) -> Drawing:
        """Make one of options; ``drawn`` holds any of :data:`orchestrator.option_values.DRAWABLE`."""
        ids, zones, frame, clock = (one in drawn for one in DRAWABLE)
        return cls(ids, zones, frame, clock, time_zone, private)

    @property
    def names(self) -> list[str]:
        """What is drawn, as the option has it."""
        return [name for name in DRAWABLE if getattr(self, name)]

    def time(self, pts: float, taken: float | None) -> str:
        """Write the time of a frame.

        Parameters
        ----------
        pts : float
            Time in the stream, s.
        taken : float, optional
            When a camera took it, seconds since 1970.
        """
        if taken is None:
            return f"{timedelta(seconds=int(pts))}.{int(pts * 10) % 10}"
        zone = None if self.time_zone is None else ZoneInfo(self.time_zone)
        moment = datetime.fromtimestamp(taken, timezone.utc).astimezone(zone)
        return f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 100_000} {moment:%Z}".rstrip()

    def caption(self, frame: int, pts: float, taken: float | None) -> str:
        """Write what stands in the corner of a frame's picture; empty for nothing."""
        words = [self.time(pts, taken)] if self.clock else []
        return "  ".join([*words, f"frame {frame}"] if self.frame else words)


DEFAULT_DRAWING = Drawing()
