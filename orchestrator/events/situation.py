"""Who is where after a row, as the events so far say: what is counted by the hour."""

from __future__ import annotations

from collections import Counter

from mlbs_actors.record.frame_row import FrameRow
from orchestrator.counts.tally import Situation
from orchestrator.events.ground import foot_of
from orchestrator.events.happenings import HOLD, Happenings

__all__ = ["situation_after"]


def situation_after(row: FrameRow, happenings: Happenings) -> Situation | None:
    """Return the situation after the newest row; None if that has no label map.

    Who has not reached the minimum is nowhere, and so is who is hidden: whether they have left the picture
    for good is only known much later.
    """
    if row.result is None:
        return None
    inside: Counter[str] = Counter()
    objects, feet = 0, []
    for one in happenings.state.objects.values():
        if not one.counts or one.missing >= HOLD:
            continue
        objects += 1
        inside.update(zone for zone, presence in one.zones.items() if presence.inside)
        if one.missing == 0:
            feet.append(foot_of(one.seen.region))
    places = {zone.name: zone.kind for zone in happenings.rules.zones}
    return Situation(places, objects, inside, feet, row.result.shape)
