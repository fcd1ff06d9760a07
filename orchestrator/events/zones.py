"""Zones, lines and least sizes: what an operator wants events of, from a YAML file (``--zones``)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from mlbs_actors.errors import ConfigError
from orchestrator.rows.scene_place import Point

__all__ = ["EventRules", "Minimum", "Zone", "ZonesFile", "crossing", "is_inside", "read_zones"]

_Coordinate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Minimum(_Strict):
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


class Zone(_Strict):
    """A part of the picture or of the scene, or a line across it.

    Attributes
    ----------
    name : str
    kind : {"zone", "line"}
    polygon : tuple of (x, y)
        Corners; of a line its points, in order. If all are from 0 to 1, shares of the picture's width and
        height; else px.
    fixed_to : {"picture", "scene"}
        Whether it stays where it is in the picture, or goes with what is there in the stream's first picture;
        in a stream that had no such zone before, in the next picture.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    kind: Literal["zone", "line"] = "zone"
    polygon: tuple[tuple[_Coordinate, _Coordinate], ...]
    fixed_to: Literal["picture", "scene"] = "picture"

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
    clips : frozenset of str
        Kinds of events that get a clip.
    """

    zones: tuple[Zone, ...] = ()
    minimum: Minimum = field(default_factory=Minimum)
    remembered: int = 30
    clips: frozenset[str] = frozenset()

    @property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that tell them from others which say something else to be an event."""
        return hashlib.sha256(_RULES.dump_json(self, exclude={"clips"})).hexdigest()[:16]

    @property
    def of_scene(self) -> bool:
        """Whether a zone is fixed to the scene."""
        return any(zone.fixed_to == "scene" for zone in self.zones)


_RULES = TypeAdapter(EventRules)


class _OfStream(_Strict):
    zones: tuple[Zone, ...] = ()
    minimum: Minimum | None = None

    @model_validator(mode="after")
    def _names_once(self) -> _OfStream:
        names = [zone.name for zone in self.zones]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two zones are named {twice!r}")
        return self


class _Content(_Strict):
    streams: dict[str, _OfStream] = {}
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
    """

    path: Path | None = None
    text: str | None = None
    content: _Content = field(default_factory=_Content)
    fault: str | None = None

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
        own = self.content.streams.get(stream, _OfStream())
        return EventRules(own.zones, own.minimum or self.content.minimum, remembered)


def read_zones(path: Path) -> ZonesFile:
    """Read and check a file of zones.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds anything that is not understood; names the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
        tree = yaml.compose(text, yaml.SafeLoader)
        if tree is None:
            raise ConfigError(f"--zones: {path} is empty; name at least one stream below 'streams:'.")
        _refuse_twice(path, tree)
        content = _Content.model_validate(yaml.safe_load(text))
    except OSError as error:
        raise ConfigError(f"--zones: {path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise ConfigError(f"--zones: {path} is no text in UTF-8.") from None
    except yaml.MarkedYAMLError as error:
        line = 1 if error.problem_mark is None else error.problem_mark.line + 1
        raise ConfigError(f"--zones: {path}, line {line}: {error.problem}.") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"--zones: {path} is no YAML: {error}") from None
    except ValidationError as invalid:
        faults = "\n".join(f"  {_fault(tree, fault['loc'], fault['msg'])}" for fault in invalid.errors())
        raise ConfigError(f"--zones: {path} cannot be used:\n{faults}") from None
    except (ValueError, TypeError, RecursionError) as error:  # such as a date that there is not, or a loop
        raise ConfigError(f"--zones: {path} cannot be understood: {error}.") from None
    return ZonesFile(path.absolute(), text, content)


def _refuse_twice(path: Path, node: yaml.Node) -> None:
    """Refuse a key that stands twice in one mapping: YAML would silently take the last."""
    if isinstance(node, yaml.MappingNode):
        names = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise ConfigError(f"--zones: {path}, line {key.start_mark.line + 1}: this is no name.")
            if key.value in names:
                raise ConfigError(
                    f"--zones: {path}, line {key.start_mark.line + 1}: {key.value!r} stands there twice."
                )
            names.add(key.value)
            _refuse_twice(path, value)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_twice(path, item)


def _fault(tree: yaml.Node | None, place: Sequence[int | str], message: str) -> str:
    node, words = tree, message.removeprefix("Value error, ")
    for depth, step in enumerate(place, start=1):
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if str(key.value) == str(step)]
            if not found:
                break  # it is missing
            key, node = found[0]
            if depth == len(place) and words.startswith("Extra inputs"):
                node, words = key, "there is no such key"
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
    where = ".".join(map(str, place))
    line = 1 if node is None else node.start_mark.line + 1
    return f"line {line}: {where + ': ' if where else ''}{words}"


def is_inside(point: Point, corners: Sequence[Point]) -> bool:
    """Whether a point is inside a polygon, by the even-odd rule."""
    x, y = point
    inside = False
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside


def crossing(start: Point, end: Point, line: Sequence[Point]) -> Literal["left", "right"] | None:
    """Tell to which side of a line a straight way leads.

    Parameters
    ----------
    start, end : (x, y)
        Of the way.
    line : sequence of (x, y)
        At least two points.

    Returns
    -------
    {"left", "right"} or None
        The side on which the way ends, as seen by somebody who looks along the line from its first point;
        None if it crosses the line not at all, or back and forth.
    """
    crossed = [side for a, b in pairwise(line) if (side := _side(start, end, a, b)) is not None]
    return crossed[-1] if len(crossed) % 2 else None


def _side(start: Point, end: Point, a: Point, b: Point) -> Literal["left", "right"] | None:
    # A point on the line belongs to one of its sides, so that each crossing counts once.
    before, after = _turn(a, b, start) >= 0, _turn(a, b, end) >= 0
    if before == after or (_turn(start, end, a) >= 0) == (_turn(start, end, b) >= 0):
        return None
    return "right" if after else "left"  # y points downwards


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
