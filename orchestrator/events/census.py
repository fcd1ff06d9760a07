"""Who is in which zone, and how many went over each line: the sum of a stream's events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter

__all__ = ["Census"]


@dataclass(slots=True)
class Census:
    """What the events of a stream come to, up to one of them.

    Attributes
    ----------
    inside : dict of str to set of int
        The objects in each zone.
    crossed : dict of str to (dict of str to int)
        How many objects went over each line to its ``left`` and ``right``.
    lost : bool
        Whether the source is away.
    pictures : dict of str to (int, str)
        The number of the newest event of each kind that has a picture, and that, in the stream's folder.
    """

    inside: dict[str, set[int]] = field(default_factory=dict)
    crossed: dict[str, dict[str, int]] = field(default_factory=dict)
    lost: bool = False
    pictures: dict[str, tuple[int, str]] = field(default_factory=dict)

    @classmethod
    def read(cls, text: str) -> Census:
        """Return what :meth:`text` has written."""
        return _CENSUS.validate_json(text)

    def text(self) -> str:
        """Return it as JSON."""
        return _CENSUS.dump_json(self).decode()

    def add(self, event: Mapping[str, Any], *, final: bool) -> None:
        """Add the next event, a line of the file; counts, which must never shrink, only if it is final."""
        kind, zone = event["kind"], str(event.get("zone"))
        if kind == "entered":
            self.inside.setdefault(zone, set()).add(event["object"])
        elif kind == "left":
            self.inside.get(zone, set()).discard(event["object"])
        elif kind == "crossed" and final:
            ways = self.crossed.setdefault(zone, {"left": 0, "right": 0})
            ways[event["direction"]] += 1
        elif kind in ("stream lost", "stream back"):
            self.lost = kind == "stream lost"
        if event.get("picture"):
            self.pictures[kind] = event["number"], event["picture"]


_CENSUS = TypeAdapter(Census)
