"""Zones, lines, least sizes and rules: what an operator wants events of, from a YAML file (``--zones``)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.scene_place import Point
from orchestrator.events.event import EventKind
from orchestrator.events.object_filter import Strict
from orchestrator.events.polygons import read_polygon
from orchestrator.events.rules import Rule, check_rules
from orchestrator.yaml_file import faults_of, read_yaml

__all__ = ["EventRules", "EventSettings", "Minimum", "Zone", "ZonesFile", "read_zones"]

_Coordinate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Minimum(Strict):
    """What an object must reach, all in one frame, before it has events.

    Attributes
    ----------
    area : float
        px.
    seconds : float
        Time since it was first seen, s.
    speed : float
        Relative to the background, px/s.
    """

    area: _NotNegative = 0.0
    seconds: _NotNegative = 0.0
    speed: _NotNegative = 0.0


class Zone(Strict):
    """A part of the picture or of the scene, or a line across it.

    Attributes
    ----------
    name : str
    kind : {"zone", "line"}
    polygon : tuple of (x, y)
        Corners; of a line its points, in order. If all are from 0 to 1, shares of the picture's width and
        height; else px. It may be written in other ways, too: see :func:`.polygons.read_polygon`; and be
        called ``coordinates``.
    fixed_to : {"picture", "scene"}
        Whether it stays where it is in the picture, or goes with what is there in the stream's first picture;
        in a stream that had no such zone before, in the next picture.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    kind: Literal["zone", "line"] = "zone"
    polygon: Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], BeforeValidator(read_polygon)]
    fixed_to: Literal["picture", "scene"] = "picture"

    @model_validator(mode="before")
    @classmethod
    def _as_written(cls, written: Any) -> Any:
        if isinstance(written, dict) and "coordinates" in written and "polygon" not in written:
            return {"polygon" if key == "coordinates" else key: value for key, value in written.items()}
        return written

    @field_validator("polygon")
    @classmethod
    def _of_one_unit(cls, polygon: tuple[Point, ...]) -> tuple[Point, ...]:
        values = [value for point in polygon for value in point]
        if any(0 < value < 1 for value in values) and max(values) > 1:
            raise ValueError(
                f"it has both shares of the picture, from 0 to 1, and px ({max(values):g}); write all values "
                "as shares, such as [0.5, 1], or all in px, such as [320, 480]"
            )
        return polygon

    @model_validator(mode="after")
    def _has_extent(self) -> Zone:
        least = 3 if self.kind == "zone" else 2
        if len(set(self.polygon)) < least:
            raise ValueError(f"the polygon of a {self.kind} needs at least {least} different points")
        return self

    def corners(self, shape: tuple[int, int]) -> tuple[Point, ...]:
        """Return the points in a picture of ``shape`` (H, W), px."""
        if max(max(point) for point in self.polygon) > 1:
            return self.polygon
        height, width = shape
        return tuple((x * width, y * height) for x, y in self.polygon)


@dataclass(frozen=True, slots=True)
class EventRules:
    """What the events of one stream depend on.

    Attributes
    ----------
    zones : tuple of Zone
    minimum : Minimum
    remembered : int
        Label maps without a pixel of an object after which it has ended.
    rules : tuple of Rule
    settings : str
        What tells all else that the record depends on from other settings.
    clips : frozenset of str
        Kinds of events that get a clip.
    told : mapping of str to object
        Those settings by name, as JSON has them, for who reads what has changed.
    """

    zones: tuple[Zone, ...] = ()
    minimum: Minimum = field(default_factory=Minimum)
    remembered: int = 30
    rules: tuple[Rule, ...] = ()
    settings: str = ""
    clips: frozenset[EventKind] = frozenset()
    told: Mapping[str, Any] = field(default_factory=dict)

    def described(self) -> dict[str, Any]:
        """Return all that they say, by name, as JSON has it."""
        given: dict[str, Any] = _RULES.dump_python(
            self, mode="json", include={"minimum", "zones", "rules"}, exclude_defaults=True
        )
        named = {
            f"{key}.{one['name']}": {name: value for name, value in one.items() if name != "name"}
            for key in ("zones", "rules")
            for one in given.get(key, ())
        }
        minimum = {f"minimum.{name}": value for name, value in given.get("minimum", {}).items()}
        return {**self.told, **minimum, **named}

    @property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that tell them from others which say something else to be an event."""
        # Records of before there were these have the digests of what is left without them.
        absent = {key for key in ("rules", "settings") if not getattr(self, key)}
        text = _RULES.dump_json(self, exclude={"clips", "told"} | absent)
        return hashlib.sha256(text).hexdigest()[:16]

    @property
    def of_scene(self) -> bool:
        """Whether a zone is fixed to the scene."""
        return any(zone.fixed_to == "scene" for zone in self.zones)


_RULES = TypeAdapter(EventRules)


class EventSettings(Strict):
    """What an operator writes of one stream, below its name.

    Attributes
    ----------
    zones : tuple of Zone
    minimum : Minimum, optional
        By default that of all streams.
    rules : tuple of Rule
    """

    zones: tuple[Zone, ...] = ()
    minimum: Minimum | None = None
    rules: tuple[Rule, ...] = ()

    @model_validator(mode="after")
    def _fits_together(self) -> EventSettings:
        names = [zone.name for zone in self.zones]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two zones are named {twice!r}")
        check_rules(self.rules, {zone.name: zone.kind for zone in self.zones})
        return self

    def event_rules(self, minimum: Minimum, remembered: int) -> EventRules:
        """Return what the events depend on; ``minimum`` is that of all streams."""
        return EventRules(self.zones, self.minimum or minimum, remembered, self.rules)


class _Content(Strict):
    streams: dict[str, EventSettings] = Field(default_factory=dict)
    minimum: Minimum = Minimum()


@dataclass(frozen=True, slots=True)
class ZonesFile:
    """What the file says, or a run without one.

    Attributes
    ----------
    path : Path, optional
        Absolute.
    text : str, optional
    content
        For :meth:`rules_of`.
    fault : str, optional
        Why the rest is of an earlier version, a sentence.
    stamp : tuple of int, optional
        Of the file as it was read, if that is known: see :func:`orchestrator.run.file_watch.stamp_of`.
    """

    path: Path | None = None
    text: str | None = None
    content: _Content = field(default_factory=_Content)
    fault: str | None = None
    stamp: tuple[int, ...] | None = None

    @property
    def digest(self) -> str | None:
        """SHA-256 of the text."""
        return None if self.text is None else hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def streams(self) -> set[str]:
        """The streams that it names."""
        return set(self.content.streams)

    def rules_of(self, stream: str, remembered: int) -> EventRules:
        """Return the rules of a stream; see :class:`EventRules` for ``remembered``."""
        own = self.content.streams.get(stream, EventSettings())
        return own.event_rules(self.content.minimum, remembered)


def read_zones(path: Path, named: str = "--zones") -> ZonesFile:
    """Read and check a file of zones.

    Parameters
    ----------
    path : Path
    named : str
        What names the file, for messages.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds anything that is not understood; names the line.
    """
    file = read_yaml(path, named)
    if file.tree is None:
        raise ConfigError(f"{named}: {path} is empty; name at least one stream below 'streams:'.")
    try:
        content = _Content.model_validate(file.content)
    except ValidationError as invalid:
        faults = faults_of(file.tree, invalid, model=_Content)
        lines = "\n".join(f"  line {line}: {words}" for line, words in faults.items())
        raise ConfigError(f"{named}: {path} cannot be used:\n{lines}") from None
    return ZonesFile(path.absolute(), file.text, content)
