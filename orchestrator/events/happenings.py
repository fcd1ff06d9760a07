"""The events of each frame: a pure state machine over the rows of a record.

What is said depends on the rows, when they were taken, and the rules alone. So a stream that goes back to a
row, with the state of then, says the same again. Nothing is said of the layer of kind ``other``, which is
many objects at once. A zone that is fixed to the scene is looked at in the stream's first picture: there it
stays where it is.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from mlbs_actors.messages import LayerSummary
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from orchestrator.counts.tally import Situation
from orchestrator.events.event import Event
from orchestrator.events.event_state import Approach, EventState, Followed, Presence
from orchestrator.events.faults import faults
from orchestrator.events.ground import crossing, foot_of, is_inside, on_ground
from orchestrator.events.rule_machine import rule_events
from orchestrator.events.zones import EventRules, Zone
from orchestrator.rows.endings import SEEN, ending
from orchestrator.rows.sighting import Sighting

__all__ = ["HOLD", "Happenings"]

#: Label maps in a row that must agree before an object is hidden, in a zone, out of it, or beyond a line.
HOLD = 3

#: Motion of the picture from which on a camera moves, as a share of the longer side per frame; below half of
#: it a camera is still.
_MOVING = 0.001

#: Label maps in a row before a camera moves, and before it is still: somebody who walks with it sways.
_HOLD_MOVING, _HOLD_STILL = 3, 10

#: Frames over which the share of dropped ones before something is averaged.
_RECENT_FRAMES = 32


class Happenings:
    """The events of one stream.

    Parameters
    ----------
    rules : EventRules
    state : EventState, optional
        Where to continue; by default at the stream's start.

    Attributes
    ----------
    rules : EventRules
    state : EventState
    """

    def __init__(self, rules: EventRules, state: EventState | None = None) -> None:
        self.state = EventState() if state is None else state
        self.rules = rules

    def after(self, row: FrameRow, clock: float | None = None) -> list[Event]:
        """Return what is certain with the next row of the record, in a fixed order.

        Parameters
        ----------
        row : FrameRow
        clock : float, optional
            When it was taken, seconds since 1970, if known.
        """
        state = self.state
        state.rows, state.newest = row.frame + 1, row.pts
        if row.status != "gap":
            state.dropped_share += ((row.result is None) - state.dropped_share) / _RECENT_FRAMES
        if row.status == "gap" and not state.lost:
            state.lost = True
            return [Event("stream lost", row.frame, row.pts)]
        if row.result is None:
            return []
        said = []
        if state.lost:
            state.lost = False
            said.append(Event("stream back", row.frame, row.pts))
        said += self._camera(row, row.result)
        present = {layer.layer: layer for layer in row.result.layers if layer.kind == "object"}
        for number in sorted(state.objects.keys() - present.keys()):
            said += self._missing(number, row, row.result)
        for number in sorted(present):
            said += self._present(present[number], row, row.result)
        said += faults(self.rules, state, row, row.result, clock)
        said += rule_events(self.rules, state, said, row, row.result, clock)
        state.shown, state.pts = replace(row.result, stage_ms={}), row.pts
        return said

    def situation(self, row: FrameRow) -> Situation | None:
        """Return who is where after the newest row, for the counts; None if that has no label map.

        Who has not reached the minimum is nowhere, and so is who is hidden: whether they have left the
        picture for good is only known much later.
        """
        if row.result is None:
            return None
        there = [one for one in self.state.objects.values() if one.counts and one.missing < HOLD]
        inside = Counter(zone for one in there for zone, presence in one.zones.items() if presence.inside)
        feet = [foot_of(one.seen.region) for one in there if one.missing == 0]
        places = {zone.name: zone.kind for zone in self.rules.zones}
        return Situation(places, len(there), inside, feet, row.result.shape)

    def silent(self) -> list[Event]:
        """Return that the source is away, as the gap that follows will say, too; nothing if that is known."""
        state = self.state
        if state.lost or state.rows == 0:
            return []
        state.lost = True
        return [Event("stream lost", state.rows, state.newest)]

    def configured(self, rules: EventRules) -> list[Event]:
        """Follow other rules from now on; return this, and who has left zones that are gone.

        Who is in a zone stays in it until they are certainly out of it, where it is now; and what was not
        certain yet by the rules of before is none.
        """
        self.rules, self.state.faults = rules, []
        there = {zone.name: zone.kind for zone in rules.zones}
        last = max(self.state.rows - 1, 0), self.state.newest
        said = [Event("configured", *last, reason=rules.digest)]
        for number, one in sorted(self.state.objects.items()):
            for name, presence in list(one.zones.items()):
                if there.get(name) != "zone":
                    del one.zones[name]
                    if presence.inside and one.counts:
                        left = one.event("left", number, *last, _since(presence))
                        said.append(replace(left, zone=name, reason="the zone is gone"))
            for presence in one.zones.values():
                presence.contrary = 0
            one.lines.clear()
        return said

    def end(self) -> list[Event]:
        """Return what is certain as the stream has come to its end; nothing is left to follow."""
        said: list[Event] = []
        for number in sorted(self.state.objects):
            said += self._ended(number)
        return said

    def _camera(self, row: FrameRow, result: ResultRow) -> Iterator[Event]:
        # A repetition has no motion, so a camera that moved may have stopped. One that stood may move all the
        # same: of a video that shows each picture twice, every other one is a repetition.
        if row.status != "ok" and not (row.status == "repeated" and self.state.moving):
            return
        state, speed = self.state, math.hypot(*result.camera_motion) / max(result.shape)
        if (speed >= _MOVING / 2) if state.moving else (speed <= _MOVING):
            state.contrary = 0
            return
        if state.contrary == 0:
            state.first = row.frame, row.pts
        state.contrary += 1
        if state.first is not None and state.contrary == (_HOLD_STILL if state.moving else _HOLD_MOVING):
            state.moving, state.contrary = not state.moving, 0
            yield Event("camera moving" if state.moving else "camera still", *state.first)

    def _missing(self, number: int, row: FrameRow, result: ResultRow) -> list[Event]:
        one, before = self.state.objects[number], self.state.shown
        if one.missing == 0 and before is not None:
            place = next(place for place, layer in enumerate(before.layers) if layer.layer == number)
            one.ending = ending(place, before, result, cut=row.status == "cut")
            one.gone = row.frame, row.pts
            for presence in one.zones.values():
                presence.contrary = 0
            for approach in one.lines.values():
                approach.beyond = 0
        one.missing += 1
        scene_ends = row.status == "cut" or (before is not None and before.shape != result.shape)
        if scene_ends or one.missing > self.rules.remembered:
            return self._ended(number)
        if one.missing == HOLD and one.counts and one.gone is not None:
            one.hidden = True
            words, by = one.ending.words, one.ending.by
            return [replace(one.event("hidden", number, *one.gone), reason=words, replaced_by=by)]
        return []

    def _ended(self, number: int) -> list[Event]:
        one = self.state.objects.pop(number)
        if not one.counts:
            return []
        (frame, pts), words = (one.seen.frame, one.seen.pts), "end of the stream"
        if one.gone is not None:
            (frame, pts), words = one.gone, one.ending.words
        said = [
            replace(one.event("left", number, frame, pts, _since(presence)), zone=zone)
            for zone, presence in one.zones.items()
            if presence.inside
        ]
        ended = one.event("ended", number, frame, pts)
        return [*said, replace(ended, reason=words, replaced_by=one.ending.by)]

    def _present(self, layer: LayerSummary, row: FrameRow, result: ResultRow) -> list[Event]:
        number, here = layer.layer, Sighting.of(layer, row)
        one = self.state.objects.setdefault(number, Followed(born=here, seen=here))
        was_hidden = one.hidden
        one.seen, one.missing, one.gone, one.ending, one.hidden = here, 0, None, SEEN, False
        one.score, one.area = float(layer.score), int(layer.area)
        said = [one.event("back", number, here.frame, here.pts)] if was_hidden else []
        for zone in self.rules.zones:
            follow = _crossed if zone.kind == "line" else _moved
            said += follow(zone, one, number, result)
        if one.counts:
            return said
        one.counts = self._reaches_minimum(one, layer, row, result)
        if not one.counts:
            return []
        born = one.event("born", number, one.born.frame, one.born.pts)
        return [replace(born, region=one.born.region), *_inside_already(one, number)]

    def _reaches_minimum(self, one: Followed, layer: LayerSummary, row: FrameRow, result: ResultRow) -> bool:
        least = self.rules.minimum
        if layer.area < least.area or row.pts - one.born.pts < least.seconds:
            return False
        if least.speed == 0:
            return True
        seconds = row.pts - self.state.pts
        way = math.dist(layer.velocity, result.camera_motion)
        return self.state.shown is not None and seconds > 0 and way / seconds >= least.speed


def _moved(zone: Zone, one: Followed, number: int, result: ResultRow) -> Iterator[Event]:
    """Yield that the object went into a zone, or out of it."""
    here, presence = one.seen, one.zones.setdefault(zone.name, Presence())
    known = on_ground(here.region, zone, result)
    if known is None:
        return
    if is_inside(*known) == presence.inside:
        presence.contrary = 0
        return
    if presence.contrary == 0:
        presence.first = here
    presence.contrary += 1
    if presence.contrary == HOLD and (first := presence.first) is not None:
        presence.inside, presence.contrary = not presence.inside, 0
        if presence.inside:
            presence.since = first
            event = one.event("entered", number, first.frame, first.pts)
        else:
            event = one.event("left", number, first.frame, first.pts, _since(presence))
        yield replace(event, region=first.region, zone=zone.name)


def _crossed(zone: Zone, one: Followed, number: int, result: ResultRow) -> Iterator[Event]:
    """Yield that the object went over a line."""
    here, known = one.seen, on_ground(one.seen.region, zone, result)
    if known is None:
        return
    foot, line = known
    approach = one.lines.setdefault(zone.name, Approach(foot))
    direction = crossing(approach.foot, foot, line)
    if direction is not None:
        if approach.beyond == 0:
            approach.first = here
        approach.beyond += 1
        if approach.beyond < HOLD:
            return
        if (first := approach.first) is not None:
            event = one.event("crossed", number, first.frame, first.pts)
            yield replace(event, region=first.region, zone=zone.name, direction=direction)
    approach.foot, approach.beyond = foot, 0


def _inside_already(one: Followed, number: int) -> Iterator[Event]:
    for zone, presence in one.zones.items():
        if presence.inside and (since := presence.since) is not None:
            event = one.event("entered", number, since.frame, since.pts)
            yield replace(event, region=since.region, zone=zone)


def _since(presence: Presence) -> float | None:
    return None if presence.since is None else presence.since.pts
