"""All that the next events of a stream depend on, besides its rules; it is kept with every commit."""

from __future__ import annotations

from dataclasses import dataclass, field

from mlbs_actors.record.frame_row import ResultRow
from mlbs_actors.record.scene_place import Point
from orchestrator.events.event import Event, EventKind
from orchestrator.rows.endings import SEEN, Ending
from orchestrator.rows.sighting import Sighting

__all__ = ["Approach", "EventState", "Followed", "Presence", "RuleState"]


@dataclass(slots=True)
class Presence:
    """Whether an object is in a zone.

    Attributes
    ----------
    inside : bool
    since : Sighting, optional
        Where it came in.
    contrary : int
        Label maps in a row that say the opposite.
    first : Sighting, optional
        The first of these.
    """

    inside: bool = False
    since: Sighting | None = None
    contrary: int = 0
    first: Sighting | None = None


@dataclass(slots=True)
class Approach:
    """On which side of a line an object is.

    Attributes
    ----------
    foot : (x, y)
        Where it last certainly was, px; for a line of the scene in the stream's first picture.
    beyond : int
        Label maps in a row that show it on the other side.
    first : Sighting, optional
        The first of these.
    """

    foot: Point
    beyond: int = 0
    first: Sighting | None = None


@dataclass(slots=True)
class Followed:
    """An object that has not ended.

    Attributes
    ----------
    born, seen : Sighting
        The first and the newest.
    counts : bool
        Whether it has reached the minimum, so that events were reported.
    missing : int
        Label maps since the newest sighting.
    gone : (int, float), optional
        Frame and time of the first of these, s.
    ending : Ending
        What the first of these tells.
    hidden : bool
        Whether that was reported.
    score : float, optional
        Of the newest mask, 0 to 1; None if an earlier version followed it.
    area : int, optional
        Of the newest mask, px.
    zones : dict of str to Presence
    lines : dict of str to Approach
    """

    born: Sighting
    seen: Sighting
    counts: bool = False
    missing: int = 0
    gone: tuple[int, float] | None = None
    ending: Ending = SEEN
    hidden: bool = False
    score: float | None = None
    area: int | None = None
    zones: dict[str, Presence] = field(default_factory=dict)
    lines: dict[str, Approach] = field(default_factory=dict)

    def event(
        self, kind: EventKind, number: int, frame: int, pts: float, since: float | None = None
    ) -> Event:
        """Return one of its events; the ``seconds`` of that begin at a time, by default its birth."""
        seconds = pts - (self.born.pts if since is None else since)
        return Event(
            kind, frame, pts, number, self.seen.region, score=self.score, area=self.area, seconds=seconds
        )


@dataclass(slots=True)
class RuleState:
    """What a rule has seen and said.

    Attributes
    ----------
    digest : str
        Of the rule: another one of its name begins anew.
    began : float
        Time of the first picture that it looked at, s.
    said : float, optional
        Time of the picture with which it last said something, s.
    stays : dict of int to int
        Of ``dwell``: the objects whose stay was told, and the frames in which they came in.
    steps : dict of int to list of float
        Of ``sequence``: when objects last did the first of the two, s.
    since : float, optional
        Of ``count`` in a zone: since when there are enough, s.
    is_told : bool
        And whether that was said.
    crossings : list of (float, int, int)
        Of ``count`` over a line: the newest that count, by time, s, frame and object.
    """

    digest: str
    began: float
    said: float | None = None
    stays: dict[int, int] = field(default_factory=dict)
    steps: dict[int, list[float]] = field(default_factory=dict)
    since: float | None = None
    is_told: bool = False
    crossings: list[tuple[float, int, int]] = field(default_factory=list)


@dataclass(slots=True)
class EventState:
    """All that the next events depend on, besides the rules.

    Attributes
    ----------
    shown : ResultRow, optional
        The newest label map.
    pts : float
        Its time, s.
    objects : dict of int to Followed
    moving : bool
        Whether the camera moves.
    contrary : int
        Label maps in a row that say the opposite.
    first : (int, float), optional
        Frame and time of the first of these, s.
    lost : bool
        Whether the source is away.
    rows : int
        Of the record so far.
    newest : float
        Time of the last of these, s.
    dropped_share : float
        Share of the last frames that have no label map: a mean with weights that decay over 32 frames.
    rules : dict of str to RuleState
        By the rules' names.
    faults : list of str
        What has been said of the zones and rules of now, so that it is said once.
    """

    shown: ResultRow | None = None
    pts: float = 0.0
    objects: dict[int, Followed] = field(default_factory=dict)
    moving: bool = False
    contrary: int = 0
    first: tuple[int, float] | None = None
    lost: bool = False
    rows: int = 0
    newest: float = 0.0
    dropped_share: float = 0.0
    rules: dict[str, RuleState] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
