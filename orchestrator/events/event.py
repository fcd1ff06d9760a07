"""Something that happened in a stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mlbs_actors.messages import Region

__all__ = ["Event", "EventKind"]

EventKind = Literal[
    "born",
    "hidden",
    "back",
    "ended",
    "entered",
    "left",
    "crossed",
    "camera moving",
    "camera still",
    "stream lost",
    "stream back",
    "configured",
    "rule",
    "fault",
]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened.

    Attributes
    ----------
    kind : EventKind
    frame : int
        When it began, which is some frames before it was certain.
    pts : float
        s.
    layer : int, optional
        The object.
    region : Region, optional
        The object's box in that frame, or in the last one that showed it.
    zone : str, optional
        Of ``entered``, ``left`` and ``crossed``.
    direction : {"left", "right"}, optional
        Of ``crossed``; see :func:`orchestrator.events.zones.crossing`.
    reason : str, optional
        Of ``hidden`` and ``ended``, and of ``left`` if the zone is gone; of ``configured`` the digest of the
        rules, so that two changes between two pictures are two events.
    replaced_by : int, optional
        The object in its place.
    """

    kind: EventKind
    frame: int
    pts: float
    layer: int | None = None
    region: Region | None = None
    zone: str | None = None
    direction: Literal["left", "right"] | None = None
    reason: str | None = None
    replaced_by: int | None = None
