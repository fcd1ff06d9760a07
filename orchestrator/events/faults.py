"""What cannot work as it is written, known only with the stream's pictures."""

from __future__ import annotations

from collections.abc import Iterator

from mlbs_actors.record.frame_row import FrameRow, ResultRow
from orchestrator.events.event import Event
from orchestrator.events.event_state import EventState
from orchestrator.events.zones import EventRules, Zone

__all__ = ["faults"]

#: By how much a zone may reach beyond the picture, as a share of its side: hands are not exact.
_MARGIN = 0.05


def faults(
    rules: EventRules, state: EventState, row: FrameRow, result: ResultRow, clock: float | None
) -> Iterator[Event]:
    """Yield what cannot work, each once until there are other rules.

    Parameters
    ----------
    rules : EventRules
    state : EventState
        It is noted there.
    row : FrameRow
    result : ResultRow
        Of the row.
    clock : float, optional
        When it was taken, seconds since 1970, if known.
    """
    for zone in rules.zones:
        shape = result.shape
        if zone.fixed_to == "scene":
            if result.scene is None:
                continue
            shape = result.scene.shape
        if (reason := _outside(zone, shape)) is not None and _is_new(state, f"zone {zone.name}"):
            yield Event("fault", row.frame, row.pts, zone=zone.name, reason=reason)
    for rule in rules.rules:
        schedule = rule.schedule
        if clock is not None or schedule is None or schedule.without_clock is not None:
            continue
        if _is_new(state, f"rule {rule.name}"):
            reason = (
                "the times of day of this stream are not known, so that the rule is never in force; to have "
                "it always, write 'without_clock: always' into its schedule, or 'never' to be told no more"
            )
            place = rule.places[-1].name
            yield Event("fault", row.frame, row.pts, zone=place, rule=rule.name, reason=reason)


def _is_new(state: EventState, fault: str) -> bool:
    if fault in state.faults:
        return False
    state.faults.append(fault)
    return True


def _outside(zone: Zone, shape: tuple[int, int]) -> str | None:
    """Tell how a zone lies outside a picture of a shape (H, W); None if it does not."""
    corners = zone.corners(shape)
    height, width = shape
    right, bottom = (max(corner[axis] for corner in corners) for axis in (0, 1))
    if right <= width * (1 + _MARGIN) and bottom <= height * (1 + _MARGIN):
        return None
    left, top = (min(corner[axis] for corner in corners) for axis in (0, 1))
    how = "wholly" if left >= width or top >= height else "partly"
    return (
        f"the {zone.kind} {zone.name!r} lies {how} outside the picture, which has {width} x {height} px: it "
        f"reaches to {right:g}, {bottom:g}; write it in px of that size, or in shares from 0 to 1"
    )
