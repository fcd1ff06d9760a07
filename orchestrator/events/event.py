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
        Of ``entered``, ``left`` and ``crossed``; the last one of a rule, and the one at fault.
    direction : {"left", "right"}, optional
        Of ``crossed``; see :func:`orchestrator.events.ground.crossing`.
    reason : str, optional
        Of ``hidden`` and ``ended``, and of ``left`` if the zone is gone; of ``fault`` what cannot work, and
        why; of ``configured`` the digest of the rules, so that two changes between two pictures are two
        events.
    replaced_by : int, optional
        The object in its place.
    rule : str, optional
        Name of the rule that is met, or at fault.
    objects : tuple of int, optional
        Of ``rule``, all objects by which it is met, ascending.
    score : float, optional
        Of the object's newest mask, 0 to 1.
    area : int, optional
        Of that, px.
    seconds : float, optional
        Of ``left`` and of a rule of kind ``dwell`` how long the object was in the zone, otherwise its age, s.
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
    rule: str | None = None
    objects: tuple[int, ...] | None = None
    score: float | None = None
    area: int | None = None
    seconds: float | None = None
