"""When a rule is in force: on which days and at which hours, where the camera is."""

from __future__ import annotations

from datetime import datetime, time, timedelta
from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field

from orchestrator.events.object_filter import Strict

__all__ = ["Schedule"]

Day = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]

_DAYS: tuple[Day, ...] = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

_MIDNIGHT = time(0, 0)


def _hour(written: Any) -> Any:
    """Understand 24:00, and 22:00 without quotes, which in YAML is the number 1320."""
    if isinstance(written, int) and not isinstance(written, bool) and 0 <= written <= 24 * 60:
        hours, minutes = divmod(written, 60)
        written = f"{hours:02}:{minutes:02}"
    if written == "24:00":
        return _MIDNIGHT
    if isinstance(written, time):
        return written
    try:
        return datetime.strptime(written, "%H:%M").time()
    except (TypeError, ValueError):
        raise ValueError('an hour is written as "22:00"') from None


def _known_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        raise ValueError(
            f"{name!r} is no time zone that this machine knows; one is written as Europe/Berlin, or UTC. If "
            "none is known, install them: pip install tzdata"
        ) from None
    return name


_Hour = Annotated[time, BeforeValidator(_hour)]


class Schedule(Strict):
    """Days and hours, by the clocks of a place.

    Attributes
    ----------
    days : tuple of str
        On which the hours begin; by default all.
    begin, end : datetime.time
        ``from`` and ``to``: the first minute, and the first one that does not belong to it any more. If
        ``to`` is not after ``from``, the hours last into the next day; so by default it is the whole day.
    timezone : str
        Name in the IANA's list, such as ``Europe/Berlin``.
    without_clock : {"always", "never"}, optional
        Whether the rule is in force in a stream whose times of day are not known, such as a file; by default
        never, which is said.
    """

    model_config = ConfigDict(populate_by_name=True)

    days: Annotated[tuple[Day, ...], Field(min_length=1)] = _DAYS
    begin: _Hour = Field(_MIDNIGHT, alias="from")
    end: _Hour = Field(_MIDNIGHT, alias="to")
    timezone: Annotated[str, AfterValidator(_known_zone)]
    without_clock: Literal["always", "never"] | None = None

    def holds(self, clock: float | None) -> bool:
        """Whether it is in force at a time, seconds since 1970, None if that is not known."""
        if clock is None:
            return self.without_clock == "always"
        local = datetime.fromtimestamp(clock, ZoneInfo(self.timezone))
        now, today = local.time(), local.date()
        yesterday = today - timedelta(days=1)
        if self.begin < self.end:
            return self.begin <= now < self.end and self._has(today.weekday())
        return (now >= self.begin and self._has(today.weekday())) or (
            now < self.end and self._has(yesterday.weekday())
        )

    def _has(self, weekday: int) -> bool:
        return _DAYS[weekday] in self.days
