"""Which objects a stream has shown, when and where: the contents of ``objects.csv`` and ``objects.json``.

The list is derived from the rows of the record, in order. So one that is made again from the committed tables
is the same as one that has grown with them.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mlbs_actors.messages import LayerKind, LayerSummary, ObjectState
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from orchestrator.rows.endings import SEEN, Ending, ending
from orchestrator.rows.sighting import Sighting

__all__ = ["ListState", "ObjectList", "SeenObject"]

#: Least time between two points of a path, s.
_POINT_SECONDS = 1.0

_COLUMNS = (
    *("id", "kind", "state", "end", "replaced_by"),
    *("first_s", "last_s", "seconds", "first_frame", "last_frame", "frames", "times_hidden", "area_px"),
    *("first_x", "first_y", "first_w", "first_h", "last_x", "last_y", "last_w", "last_h"),
    *("start_cx", "start_cy", "end_cx", "end_cy", "path_px", "score"),
)


@dataclass(slots=True)
class SeenObject:
    """One object so far.

    Attributes
    ----------
    layer : int
    kind : {"object", "other"}
    state : {"moving", "resting"}
        When last seen.
    first, last : Sighting
    frames : int
        Label maps in which it owns pixels.
    seconds : float
        Time in which it was seen, without the times in which it was hidden or not found.
    total_area : int
        Sum over these frames, px.
    total_score : float
        Sum of the masks' scores over these frames, in the precision of the tables.
    path_px : float
        Length of the way of its centroid over the picture.
    path : list of Sighting
        The first one, and then the next after every full second; :attr:`last` is its end.
    spans : list of (int, int)
        First and last frame of every unbroken stretch. A frame without a label map breaks none.
    forgotten_spans : int
        Number of those before the first of them.
    ending : Ending
    """

    layer: int
    kind: LayerKind
    state: ObjectState
    first: Sighting
    last: Sighting
    frames: int
    seconds: float
    total_area: int
    total_score: float
    path_px: float
    path: list[Sighting]
    spans: list[tuple[int, int]]
    ending: Ending = SEEN
    forgotten_spans: int = 0

    @classmethod
    def begun(cls, layer: LayerSummary, here: Sighting) -> SeenObject:
        """Begin with the first sighting."""
        return cls(
            layer=layer.layer,
            kind=layer.kind,
            state=layer.state,
            first=here,
            last=here,
            frames=1,
            seconds=0.0,
            total_area=layer.area,
            total_score=_score(layer),
            path_px=0.0,
            path=[here],
            spans=[(here.frame, here.frame)],
        )

    @property
    def mean_area(self) -> float:
        """Mean over the frames that show it, px."""
        return self.total_area / self.frames

    @property
    def mean_score(self) -> float:
        """Mean score of its masks over the frames that show it, in [0, 1]."""
        return self.total_score / self.frames

    @property
    def times_hidden(self) -> int:
        """How often it was missing in a label map or more, and came back."""
        return self.forgotten_spans + len(self.spans) - 1

    def forget_before(self, frame: int) -> None:
        """Leave out where and when it was before a frame, but for its first sighting."""
        self.path = [place for place in self.path if place.frame >= frame] or [self.last]
        spans = [span for span in self.spans if span[1] >= frame]
        self.forgotten_spans += len(self.spans) - len(spans)
        self.spans = spans

    def continues(self, layer: LayerSummary, here: Sighting, *, unbroken: bool) -> None:
        """Add the next sighting; ``unbroken`` if the label map before shows it, too."""
        if unbroken:
            self.seconds += here.pts - self.last.pts
            self.spans[-1] = self.spans[-1][0], here.frame
        else:
            self.spans.append((here.frame, here.frame))
        self.frames += 1
        self.total_area += layer.area
        self.total_score += _score(layer)
        self.path_px += math.dist(self.last.centroid, here.centroid)
        self.state, self.last, self.ending = layer.state, here, SEEN
        if here.pts - self.path[-1].pts >= _POINT_SECONDS:
            self.path.append(here)


@dataclass(slots=True)
class ListState:
    """All that the list consists of, but for the newest label map itself.

    Attributes
    ----------
    rows : int
        Rows of the record so far.
    label_maps : int
        Those of them that have one.
    newest : (int, float), optional
        Frame and time of the newest of these, s.
    objects : mapping of int to SeenObject
        By their ids.
    """

    rows: int
    label_maps: int
    newest: tuple[int, float] | None
    objects: dict[int, SeenObject]

    @classmethod
    def begun(cls) -> ListState:
        """Begin with a record's first row."""
        return cls(rows=0, label_maps=0, newest=None, objects={})


class ObjectList:
    """The objects of one stream.

    Parameters
    ----------
    state : ListState, optional
        Where to continue; by default at the record's start.
    shown : ResultRow, optional
        The newest label map before that, if there is one.

    Attributes
    ----------
    state : ListState
    """

    def __init__(self, state: ListState | None = None, shown: ResultRow | None = None) -> None:
        self.state = ListState.begun() if state is None else state
        self._shown = shown

    @property
    def objects(self) -> list[SeenObject]:
        """All objects, in ascending id."""
        return [self.state.objects[layer] for layer in sorted(self.state.objects)]

    def add(self, rows: Iterable[FrameRow]) -> ObjectList:
        """Add the next rows; those without a label map say nothing of objects. Returns the list."""
        for row in rows:
            self.state.rows = row.frame + 1
            if row.result is not None:
                self._add(row, row.result)
        return self

    def forget_before(self, frame: int) -> None:
        """Leave out objects, and parts of paths, that were seen only before a frame."""
        self.state.objects = {
            layer: one for layer, one in self.state.objects.items() if one.last.frame >= frame
        }
        for one in self.state.objects.values():
            one.forget_before(frame)

    def _add(self, row: FrameRow, result: ResultRow) -> None:
        objects, before = self.state.objects, self._shown
        shown_before = set() if before is None else {layer.layer for layer in before.layers}
        for layer in result.layers:
            here, seen = Sighting.of(layer, row), objects.get(layer.layer)
            if seen is None:
                objects[layer.layer] = SeenObject.begun(layer, here)
            else:
                seen.continues(layer, here, unbroken=layer.layer in shown_before)
        if before is not None:
            shown = {layer.layer for layer in result.layers}
            for place, layer in enumerate(before.layers):
                if layer.layer not in shown and layer.layer in objects:
                    objects[layer.layer].ending = ending(place, before, result, cut=row.status == "cut")
        self.state.label_maps += 1
        self.state.newest, self._shown = (row.frame, row.pts), result

    def csv(self, *, complete: bool) -> str:
        """Format as CSV, a line per object.

        Parameters
        ----------
        complete : bool
            Whether the stream came to its end, so that no object can show itself again.
        """
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(_COLUMNS)
        for one in self.objects:
            table.writerow(
                [
                    *(one.layer, one.kind, *_outcome(one, complete=complete)),
                    *(_seconds(one.first.pts), _seconds(one.last.pts), _seconds(one.seconds)),
                    *(one.first.frame, one.last.frame, one.frames, one.times_hidden),
                    *(round(one.mean_area), *one.first.region.box, *one.last.region.box),
                    *(*_point(one.first), *_point(one.last), round(one.path_px, 1)),
                    round(one.mean_score, 3),
                ]
            )
        return text.getvalue()

    def json(self, stream: str, *, complete: bool) -> str:
        """Format as JSON; parameters as for :meth:`csv`, and the stream's name."""
        frame, pts = self.state.newest or (None, None)
        content = {
            "stream": stream,
            "complete": complete,
            "label_maps": self.state.label_maps,
            "last_frame": frame,
            "last_s": None if pts is None else _seconds(pts),
            "objects": [_described(one, complete=complete) for one in self.objects],
        }
        return json.dumps(content) + "\n"


def _described(one: SeenObject, *, complete: bool) -> dict[str, Any]:
    state, end, by = _outcome(one, complete=complete)
    path = one.path if one.path[-1].frame == one.last.frame else [*one.path, one.last]
    return {
        "id": one.layer,
        "kind": one.kind,
        "state": state,
        "end": end,
        "replaced_by": by,
        "seconds": _seconds(one.seconds),
        "frames": one.frames,
        "times_hidden": one.times_hidden,
        "area_px": round(one.mean_area),
        "path_px": round(one.path_px, 1),
        "score": round(one.mean_score, 3),
        "first": _sighting(one.first),
        "last": _sighting(one.last),
        "path": [[place.frame, _seconds(place.pts), *_point(place)] for place in path],
    }


def _outcome(one: SeenObject, *, complete: bool) -> tuple[str, str | None, int | None]:
    """Return the state of an object, how it ended, and what is in its place."""
    if one.ending.kind == "seen":
        return one.state, "end of the stream" if complete else None, None
    return "gone", one.ending.words, one.ending.by


def _sighting(place: Sighting) -> dict[str, Any]:
    return {
        "frame": place.frame,
        "s": _seconds(place.pts),
        "box": list(place.region.box),
        "centroid": list(_point(place)),
    }


def _score(layer: LayerSummary) -> float:
    """Return the score of a mask in the precision of the tables."""
    return float(np.float32(layer.score))


def _seconds(pts: float) -> float:
    return round(pts, 3)


def _point(place: Sighting) -> tuple[float, float]:
    return round(place.centroid[0], 1), round(place.centroid[1], 1)
