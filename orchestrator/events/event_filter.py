"""Which events a target is sent: a pure question to a line of ``events.jsonl``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, get_args

from pydantic import Field

from orchestrator.events.event import EventKind
from orchestrator.events.object_filter import ObjectFilter

__all__ = ["EventFilter"]

#: Kinds that are only written unless they are asked for: most of a busy picture's events.
_WRITTEN = frozenset[EventKind](("born", "hidden", "back", "ended"))

#: Kinds that have a zone or a line, besides the rules.
_OF_ZONES = frozenset[EventKind](("entered", "left", "crossed"))

_Names = Annotated[tuple[str, ...], Field(min_length=1)]


class EventFilter(ObjectFilter):
    """Which events are wanted; all that is given must hold.

    The bounds of objects (``score``, ``area``, ``aspect``, ``seconds``) are of an event's own keys, and let
    pass whatever has no such value, such as a camera that is lost.

    Attributes
    ----------
    kinds : tuple of EventKind, optional
        By default, if zones or rules are named, the kinds that those have; otherwise all without births,
        objects that are hidden and back, and ends.
    streams : tuple of str, optional
        By default all.
    zones : tuple of str, optional
        Zones and lines of which events are wanted; by default all.
    rules : tuple of str, optional
        Rules whose events are wanted; by default all, or those in ``zones``.
    """

    kinds: Annotated[tuple[EventKind, ...], Field(min_length=1)] | None = None
    streams: _Names | None = None
    zones: _Names | None = None
    rules: _Names | None = None

    @property
    def wanted_kinds(self) -> frozenset[EventKind]:
        """The kinds that are wanted, given or by default."""
        if self.kinds is not None:
            return frozenset(self.kinds)
        if self.zones is not None:
            return _OF_ZONES | {"rule"}
        if self.rules is not None:
            return frozenset({"rule"})
        return frozenset(get_args(EventKind)) - _WRITTEN

    def wants(self, event_line: Mapping[str, Any]) -> bool:
        """Whether an event, as its line in the file has it, is to be sent."""
        if event_line["kind"] not in self.wanted_kinds:
            return False
        if self.streams is not None and event_line["stream"] not in self.streams:
            return False
        # Lines of an earlier version lack the younger keys.
        names, name = self.zones, event_line.get("zone")
        if self.rules is not None and event_line["kind"] == "rule":
            names, name = self.rules, event_line.get("rule")
        if names is not None and name is not None and name not in names:
            return False
        box = event_line.get("box")
        aspect = None if box is None else box[2] / box[3]
        return self.takes(event_line.get("score"), event_line.get("area"), aspect, event_line.get("seconds"))
