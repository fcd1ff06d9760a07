"""The events of rules: a pure state machine over what happens in zones and at lines.

``dwell`` and ``count`` in a zone say something at the first picture in which all of it holds: long enough,
the objects as asked for, the schedule in force and the cool-down over. Once said, it is over for that stay of
the object, or until there are fewer. A ``sequence`` is a moment, which is not told later if it falls outside
the schedule or into the cool-down; crossings are counted all the same, and the next one may be told.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mlbs_actors.record.frame_row import FrameRow, ResultRow
from orchestrator.events.event import Event
from orchestrator.events.event_state import EventState, Followed, RuleState
from orchestrator.events.ground import is_inside, on_ground
from orchestrator.events.rules import Count, Dwell, Rule, Step
from orchestrator.events.zones import EventRules, Zone

__all__ = ["rule_events"]


@dataclass(frozen=True, slots=True)
class _Now:
    """What rules look at.

    Attributes
    ----------
    frame : int
    pts : float
        s.
    result : ResultRow
    began : float, optional
        When the stream began, seconds since 1970.
    objects : mapping of int to Followed
        That have reached the minimum.
    visits : sequence of Event
        Who came into a zone or over a line, as is certain with this row, in the order of time.
    zones : mapping of str to Zone
    """

    frame: int
    pts: float
    result: ResultRow
    began: float | None
    objects: Mapping[int, Followed]
    visits: Sequence[Event]
    zones: Mapping[str, Zone]

    def takes(self, rule: Rule, number: int) -> bool:
        """Whether an object, as it is now, counts for a rule."""
        one = self.objects[number]
        box = one.seen.region
        return rule.objects.takes(one.score, one.area, box.width / box.height, self.pts - one.born.pts)

    def may_say(self, rule: Rule, state: RuleState, pts: float) -> bool:
        """Whether a rule may speak of a time of the stream, s."""
        clock = None if self.began is None else self.began + pts
        cool = state.said is None or pts >= state.said + rule.cool_down
        return cool and (rule.schedule is None or rule.schedule.holds(clock))


def rule_events(
    rules: EventRules,
    state: EventState,
    said: Sequence[Event],
    row: FrameRow,
    result: ResultRow,
    clock: float | None,
) -> Iterator[Event]:
    """Yield what rules say with the next label map, at most one event each, in their order.

    Parameters
    ----------
    rules : EventRules
    state : EventState
        With this label map's objects; the rules' own part of it is replaced.
    said : sequence of Event
        What else is certain with it.
    row : FrameRow
    result : ResultRow
        Of the row.
    clock : float, optional
        When it was taken, seconds since 1970, if known.
    """
    before, state.rules = state.rules, {}
    if not rules.rules:
        return
    visits = [event for event in said if event.kind in ("entered", "crossed")]
    now = _Now(
        row.frame,
        row.pts,
        result,
        None if clock is None else clock - row.pts,
        {number: one for number, one in state.objects.items() if one.counts},
        sorted(visits, key=lambda visit: visit.pts),
        {zone.name: zone for zone in rules.zones},
    )
    for rule in rules.rules:
        known, digest = before.get(rule.name), rule.digest
        own = RuleState(digest, row.pts) if known is None or known.digest != digest else known
        state.rules[rule.name] = own
        if (event := _said_by(rule, own, now)) is not None:
            own.said = row.pts
            yield event


def _said_by(rule: Rule, state: RuleState, now: _Now) -> Event | None:
    if rule.dwell is not None:
        return _dwell(rule, rule.dwell, state, now)
    if rule.sequence is not None:
        return _sequence(rule, rule.sequence, state, now)
    if rule.count is not None:
        return (_crossings if rule.count.line is not None else _at_once)(rule, rule.count, state, now)
    return None


def _dwell(rule: Rule, dwell: Dwell, state: RuleState, now: _Now) -> Event | None:
    zone = now.zones[dwell.zone]
    stays = {
        number: presence.since
        for number, one in now.objects.items()
        if (presence := one.zones.get(zone.name)) is not None and presence.inside and presence.since
    }
    state.stays = {
        number: frame
        for number, frame in state.stays.items()
        if number in stays and stays[number].frame == frame
    }
    due = [
        number
        for number, since in stays.items()
        if number not in state.stays
        and now.pts - max(since.pts, state.began) >= dwell.seconds
        and _stands_in(zone, now.objects[number], now.result)
        and now.takes(rule, number)
    ]
    if not due or not now.may_say(rule, state, now.pts):
        return None
    state.stays |= {number: stays[number].frame for number in due}
    longest = min(due, key=lambda number: (stays[number].pts, number))
    event = now.objects[longest].event("rule", longest, now.frame, now.pts, stays[longest].pts)
    return replace(event, zone=zone.name, rule=rule.name, objects=tuple(sorted(due)))


def _sequence(rule: Rule, steps: tuple[Step, Step], state: RuleState, now: _Now) -> Event | None:
    first, second = steps
    state.steps = {number: times for number, times in state.steps.items() if number in now.objects}
    done = []
    for visit, number in _taken(rule, now):
        earlier = state.steps.get(number, [])
        if _is(second, visit) and any(0 < visit.pts - pts <= rule.within for pts in earlier):
            del state.steps[number]
            done.append(visit)
        elif _is(first, visit):
            # The newest may be of this very time, at which it is not before what else happens then.
            state.steps[number] = sorted([*earlier, visit.pts])[-2:]
    told = [visit for visit in done if now.may_say(rule, state, visit.pts)]
    return _said(rule, told[0], {visit.layer for visit in told if visit.layer is not None}) if told else None


def _at_once(rule: Rule, count: Count, state: RuleState, now: _Now) -> Event | None:
    if now.zones[count.place].fixed_to == "scene" and now.result.scene is None:
        return None  # where the zone is, nobody knows
    inside = sorted(
        number
        for number, one in now.objects.items()
        if (presence := one.zones.get(count.place)) is not None
        and presence.inside
        and now.takes(rule, number)
    )
    if len(inside) < count.at_least:
        state.since, state.is_told = None, False
        return None
    if state.since is None:
        state.since = now.pts
    if state.is_told or now.pts - state.since < count.seconds or not now.may_say(rule, state, now.pts):
        return None
    state.is_told = True
    return Event("rule", now.frame, now.pts, zone=count.place, rule=rule.name, objects=tuple(inside))


def _crossings(rule: Rule, count: Count, state: RuleState, now: _Now) -> Event | None:
    line = Step(name=count.place, direction=count.direction)
    new = {(visit.pts, visit.frame, number): visit for visit, number in _taken(rule, now) if _is(line, visit)}
    # Whether enough are close together depends on the newest ones alone.
    state.crossings = sorted([*state.crossings, *new])[-count.at_least :]
    if not new or len(state.crossings) < count.at_least:
        return None
    last = new[max(new)]
    close = state.crossings[-1][0] - state.crossings[0][0] <= count.within
    if not close or not now.may_say(rule, state, last.pts):
        return None
    numbers = {number for _, _, number in state.crossings}
    state.crossings = []
    return _said(rule, last, numbers)


def _taken(rule: Rule, now: _Now) -> Iterator[tuple[Event, int]]:
    """Yield the visits of objects that count, with their numbers."""
    for visit in now.visits:
        if visit.layer is not None and now.takes(rule, visit.layer):
            yield visit, visit.layer


def _is(step: Step, visit: Event) -> bool:
    return step.name == visit.zone and step.direction in (None, visit.direction)


def _said(rule: Rule, visit: Event, numbers: Collection[int]) -> Event:
    return replace(visit, kind="rule", rule=rule.name, objects=tuple(sorted(numbers)))


def _stands_in(zone: Zone, one: Followed, result: ResultRow) -> bool:
    known = None if one.missing else on_ground(one.seen.region, zone, result)
    return known is not None and is_inside(*known)
