"""Counts the rows of a record and their events, hour by hour: a pure state machine.

What is counted depends on the rows and their events alone, and the state is kept with the mark from which
the events continue. So a record that goes back to a row counts what follows again, and nothing twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from mlbs_actors.record.frame_row import FrameRow
from mlbs_actors.record.scene_place import Point

__all__ = [
    "HEAT_COLUMNS",
    "HEAT_ROWS",
    "HOUR_SECONDS",
    "PICTURE",
    "CountState",
    "HourCounts",
    "PlaceCounts",
    "PlaceKind",
    "Situation",
    "Tally",
    "heat_cell",
]

HOUR_SECONDS = 3600

#: Cells of the heat map over the width and the height of the picture.
HEAT_COLUMNS, HEAT_ROWS = 64, 36

#: Name of the whole picture among the places; a zone's has at least one letter.
PICTURE = ""

PlaceKind = Literal["picture", "zone", "line"]


@dataclass(slots=True)
class PlaceCounts:
    """What was counted in an hour at one place.

    Attributes
    ----------
    kind : PlaceKind
    born : int
        Objects; of the picture only.
    entered, left : int
        Of a zone only.
    crossed_left, crossed_right : int
        Of a line only.
    object_seconds : float
        Integral of the number of objects there over the observed time, s; like the next two not of lines.
    occupied_seconds : float
        Observed time in which there was one, s.
    most : int
        Objects at once.
    dropped_shares : float
        Sum over what was counted of the share of frames that were dropped before.
    """

    kind: PlaceKind
    born: int = 0
    entered: int = 0
    left: int = 0
    crossed_left: int = 0
    crossed_right: int = 0
    object_seconds: float = 0.0
    occupied_seconds: float = 0.0
    most: int = 0
    dropped_shares: float = 0.0


@dataclass(slots=True)
class HourCounts:
    """What was counted in an hour.

    Attributes
    ----------
    hour : int
        Since 1970, UTC, or since the stream's first frame.
    by_clock : bool
        Whether it is the former, as of a camera.
    seconds : float
        Observed time, from frame to frame: without the times in which a camera was away.
    frames, label_maps : int
        Rows of frames, and those of them that have a label map.
    places : dict of str to PlaceCounts
    """

    hour: int
    by_clock: bool
    seconds: float = 0.0
    frames: int = 0
    label_maps: int = 0
    places: dict[str, PlaceCounts] = field(default_factory=dict)


@dataclass(slots=True)
class CountState:
    """All that counting continues from.

    Attributes
    ----------
    hour : HourCounts, optional
        The open one; None before the first label map.
    closed_bytes : int
        Length of what is certain in ``counts.csv``.
    pts : float, optional
        Time of the last row, s; None if the time to the next one is not observed.
    present : dict of str to int
        Objects at once after the last row, by place.
    crossings : dict of str to dict of str to int
        Since the stream's start: line, direction, crossings.
    events : dict of str to int
        Since then: kind, number.
    heat : dict of int to int
        Since then: cell of the heat map, row by row, and in how many label maps an object stood there.
    """

    hour: HourCounts | None = None
    closed_bytes: int = 0
    pts: float | None = None
    present: dict[str, int] = field(default_factory=dict)
    crossings: dict[str, dict[str, int]] = field(default_factory=dict)
    events: dict[str, int] = field(default_factory=dict)
    heat: dict[int, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Situation:
    """Who is where after a row with a label map.

    Attributes
    ----------
    places : mapping of str to PlaceKind
        Zones and lines that are followed.
    objects : int
        Present.
    inside : mapping of str to int
        Those in each zone that has any.
    feet : sequence of (x, y)
        Where those that the label map shows stand, px.
    shape : (H, W)
        Of the label map.
    """

    places: Mapping[str, PlaceKind]
    objects: int
    inside: Mapping[str, int]
    feet: Sequence[Point]
    shape: tuple[int, int]


class Tally:
    """The counts of one stream.

    Parameters
    ----------
    state : CountState
        Where to continue.

    Attributes
    ----------
    state : CountState
    """

    def __init__(self, state: CountState) -> None:
        self.state = state
        self._closed: list[HourCounts] = []

    def take_closed(self) -> list[HourCounts]:
        """Return the hours that have ended since the last call, which do not change any more."""
        closed, self._closed = self._closed, []
        return closed

    def add(self, row: FrameRow, clock: float | None, situation: Situation | None) -> None:
        """Count the next row of the record, before its events.

        Parameters
        ----------
        row : FrameRow
        clock : float, optional
            When a camera took it, seconds since 1970.
        situation : Situation, optional
            After it; None without a label map.
        """
        state = self.state
        if state.hour is None and situation is None:
            return
        hour = self._hour_of(row.pts, clock)
        if row.status != "gap":
            hour.frames += 1
            hour.label_maps += situation is not None
        if state.pts is not None:
            self._observe(hour, row.pts - state.pts)
        state.pts = None if row.status == "gap" else row.pts
        if situation is None:
            return
        state.present = {PICTURE: situation.objects}
        for name, kind in {PICTURE: "picture", **situation.places}.items():
            place = hour.places.setdefault(name, PlaceCounts(kind))
            if kind == "zone":
                state.present[name] = situation.inside.get(name, 0)
            place.most = max(place.most, state.present.get(name, 0))
        for foot in situation.feet:
            cell = heat_cell(foot, situation.shape)
            state.heat[cell] = state.heat.get(cell, 0) + 1

    def count(
        self, kind: str, zone: str | None, direction: Literal["left", "right"] | None, dropped_share: float
    ) -> None:
        """Count an event that became certain with the last row, in its hour.

        Parameters
        ----------
        kind : str
            Of the event.
        zone : str, optional
            The zone or line.
        direction : {"left", "right"}, optional
            Of a crossing.
        dropped_share : float
            Of the frames before it.
        """
        state = self.state
        state.events[kind] = state.events.get(kind, 0) + 1
        if kind == "crossed" and zone is not None and direction is not None:
            state.crossings.setdefault(zone, {"left": 0, "right": 0})[direction] += 1
        if state.hour is None:
            return
        if kind == "born":
            place = state.hour.places.setdefault(PICTURE, PlaceCounts("picture"))
            place.born += 1
        elif kind in ("entered", "left") and zone is not None:
            place = state.hour.places.setdefault(zone, PlaceCounts("zone"))
            place.entered += kind == "entered"
            place.left += kind == "left"
        elif kind == "crossed" and zone is not None:
            place = state.hour.places.setdefault(zone, PlaceCounts("line"))
            place.crossed_left += direction == "left"
            place.crossed_right += direction == "right"
        else:
            return
        place.dropped_shares += dropped_share

    def _hour_of(self, pts: float, clock: float | None) -> HourCounts:
        """Return the counts of the hour of a time, which may begin with it.

        What is jitter of the camera's clock, which is estimated anew with every frame, begins none.
        """
        number, current = int((pts if clock is None else clock) // HOUR_SECONDS), self.state.hour
        if current is not None and current.hour - 1 <= number <= current.hour:
            return current
        if current is not None:
            self._closed.append(current)
        self.state.hour = HourCounts(number, clock is not None)
        return self.state.hour

    def _observe(self, hour: HourCounts, seconds: float) -> None:
        """Add the time since the last row, in which everybody stayed where they were."""
        hour.seconds += seconds
        for name, number in self.state.present.items():
            if number:
                kind: PlaceKind = "picture" if name == PICTURE else "zone"
                place = hour.places.setdefault(name, PlaceCounts(kind))
                place.object_seconds += number * seconds
                place.occupied_seconds += seconds
                place.most = max(place.most, number)


def heat_cell(foot: Point, shape: tuple[int, int]) -> int:
    """Return the cell of the heat map, counted row by row, in which a point of a picture (H, W) is."""
    column = min(max(int(foot[0] / shape[1] * HEAT_COLUMNS), 0), HEAT_COLUMNS - 1)
    row = min(max(int(foot[1] / shape[0] * HEAT_ROWS), 0), HEAT_ROWS - 1)
    return row * HEAT_COLUMNS + column
