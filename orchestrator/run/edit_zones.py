"""Zones that somebody has drawn, into the file that says which zones a stream has.

That is the file of cameras, or the one of ``--zones``. It belongs to an operator, who may be editing it too:
so it is read each time, replaced at once or not at all, and only if it says exactly what it said before, but
for the zones of that stream.
"""

from __future__ import annotations

import hashlib
import os
import threading
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from mlbs_actors.errors import ConfigError
from orchestrator.events.object_filter import Strict
from orchestrator.events.rules import Rule
from orchestrator.events.zones import EventSettings, Zone
from orchestrator.run.zone_text import WrittenZone, with_zones
from orchestrator.storage.durable_files import publish, temporary_path
from orchestrator.yaml_file import YamlFile, read_yaml, words_of

__all__ = ["DrawnZone", "StreamZones", "ZoneEditor", "ZoneFiles"]

_DECIMALS = 4  # of a share: a pixel of 4K has 0.00026
_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
_NOWHERE = (
    "No file of this run can hold drawn zones: write its streams into a file of cameras, cameras.yaml, or "
    "give --zones zones.yaml."
)


@dataclass(frozen=True, slots=True)
class ZoneFiles:
    """Where a run has its zones from.

    Attributes
    ----------
    cameras : Path, optional
        The file of cameras, if the list of streams is one.
    zones : Path, optional
        That of ``--zones``.
    watched : bool
        Whether the run follows what is changed in them.
    """

    cameras: Path | None = None
    zones: Path | None = None
    watched: bool = False


class DrawnZone(Strict):
    """A zone or a line as it was drawn.

    Attributes
    ----------
    name : str
    kind : {"zone", "line"}
    polygon : tuple of (x, y), optional
        Corners or points, shares of the picture's width and height. None if they are as they were.
    was : str, optional
        The name of before; None if it is new.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    kind: Literal["zone", "line"] = "zone"
    polygon: Annotated[tuple[tuple[_Share, _Share], ...], Field(max_length=500)] | None = None
    was: str | None = None

    @field_validator("name")
    @classmethod
    def _is_one_line(cls, name: str) -> str:
        if any(unicodedata.category(character) in ("Cc", "Zl", "Zp") for character in name):
            raise ValueError("a name is one line, without control characters")
        return name

    @model_validator(mode="after")
    def _is_somewhere(self) -> DrawnZone:
        if self.was is None and self.polygon is None:
            raise ValueError(f"the new {self.kind} {self.name!r} has no points")
        return self


@dataclass(frozen=True, slots=True)
class StreamZones:
    """The zones of a stream as its file has them.

    Attributes
    ----------
    zones : tuple of Zone
    rules : tuple of Rule
    version : str
        What tells them from those of another time.
    """

    zones: tuple[Zone, ...]
    rules: tuple[Rule, ...]
    version: str


class ZoneEditor:
    """Reads and writes the zones of streams; may be used by several threads.

    Parameters
    ----------
    files : ZoneFiles
    """

    def __init__(self, files: ZoneFiles) -> None:
        self.files = files
        self._lock = threading.Lock()

    def read(self, stream: str) -> StreamZones:
        """Return the zones of a stream.

        Raises
        ------
        ConfigError
            If no file can hold them, or it cannot be read.
        """
        return self._part(stream).zones

    def write(self, stream: str, drawn: Sequence[DrawnZone], version: str) -> None:
        """Replace the zones of a stream, and nothing else of the file.

        Parameters
        ----------
        stream : str
        drawn : sequence of DrawnZone
            All that there shall be. Those of before keep their order.
        version : str
            Of the zones that were drawn over.

        Raises
        ------
        ConfigError
            If they cannot be used, were changed by somebody else, or cannot be written.
        """
        with self._lock:
            part = self._part(stream)
            if part.zones.version != version:
                raise ConfigError("Somebody else has changed these zones since; reload the page.")
            written = _written(part, drawn)
            if [zone.content for zone in written] == part.asked.get("zones", []):
                return
            meant = part.with_zones([zone.content for zone in written])
            text = with_zones(part.text, stream, written)
            if not _says(text, meant):
                raise ConfigError(
                    f"{part.path.name} is written in a way in which its zones cannot be replaced safely; "
                    "change them there by hand."
                )
            _replace(part.path, part.text, text)

    def _part(self, stream: str) -> _Part:
        """Return what is written of a stream in the file that holds, or may hold, its zones."""
        cameras, zones = self.files.cameras, self.files.zones
        other = None if zones is None else read_yaml(zones, "--zones")
        if cameras is not None:
            file = read_yaml(cameras, "--streams")
            entry, defaults = _entry(file.content, stream)
            named = other is not None and _entry(other.content, stream)[0] is not None
            own = EventSettings.model_fields.keys() & {*defaults, *(entry if isinstance(entry, dict) else ())}
            if entry is not None and (own or not named):
                return _of_stream(cameras, file, stream, defaults)
        if zones is None or other is None:
            raise ConfigError(_NOWHERE)
        return _of_stream(zones, other, stream, {})


@dataclass(frozen=True, slots=True)
class _Part:
    """What a file says of one stream.

    Attributes
    ----------
    path : Path
    text : str
        The whole file, with the ends of its lines as they are.
    content
        The same as values.
    stream : str
    asked : dict
        Zones and rules as they are written, with the defaults of all streams.
    zones : StreamZones
    """

    path: Path
    text: str
    content: dict[str, Any] = field(repr=False)
    stream: str
    asked: dict[str, Any]
    zones: StreamZones

    def with_zones(self, zones: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the content of the file with other zones; ConfigError if they do not suit the rules."""
        try:
            EventSettings.model_validate(self.asked | {"zones": list(zones)})
        except ValidationError as invalid:
            raise ConfigError(_words_of(invalid, [str(zone.get("name")) for zone in zones])) from None
        meant = deepcopy(self.content)
        streams = meant["streams"] = meant.get("streams") or {}
        key = next((key for key in streams if str(key) == self.stream), self.stream)
        entry = _entry(self.content, self.stream)[0]
        before = {"source": entry} if isinstance(entry, str) else entry
        streams[key] = (before if isinstance(before, dict) else {}) | {"zones": list(zones)}
        return meant


def _entry(content: object, stream: str) -> tuple[object, dict[str, Any]]:
    """Return what a file says of a stream, None if it does not name it, and what it says of all."""
    if not isinstance(content, dict):
        return None, {}
    streams, defaults = content.get("streams"), content.get("defaults")
    entries = {str(key): entry for key, entry in streams.items()} if isinstance(streams, dict) else {}
    entry = ({} if entries[stream] is None else entries[stream]) if stream in entries else None
    return entry, defaults if isinstance(defaults, dict) else {}


def _of_stream(path: Path, file: YamlFile, stream: str, defaults: dict[str, Any]) -> _Part:
    if not isinstance(file.content, dict):
        raise ConfigError(f"{path.name} is no mapping of keys to values.")
    entry, _ = _entry(file.content, stream)
    whole = defaults | (entry if isinstance(entry, dict) else {})
    asked = {key: whole[key] for key in EventSettings.model_fields if whole.get(key) is not None}
    try:
        settings = EventSettings.model_validate(asked)
    except ValidationError as invalid:
        raise ConfigError(
            f"Nothing can be drawn, as {path.name} has a fault below {stream}: {_words_of(invalid, [])}"
        ) from None
    digest = hashlib.sha256(settings.model_dump_json().encode()).hexdigest()[:16]
    zones = StreamZones(settings.zones, settings.rules, digest)
    return _Part(path.resolve(), file.text, file.content, stream, asked, zones)


def _written(part: _Part, drawn: Sequence[DrawnZone]) -> list[WrittenZone]:
    """Return what is to be written for drawn zones: those of before in their order, then the new ones."""
    raw = part.asked.get("zones", [])
    places = {zone.name: place for place, zone in enumerate(part.zones.zones)}
    # Those that come from the defaults, or from another part by <<, are not written below the stream yet.
    written: dict[int, WrittenZone] = {}
    new = []
    for zone in drawn:
        if zone.was is None:
            new.append(WrittenZone(_content(zone)))
            continue
        place = places.get(zone.was)
        if place is None or place in written:
            raise ConfigError(f"There is no zone {zone.was!r} any more; reload the page.")
        content = dict(raw[place])
        if zone.polygon is not None:
            content.pop("coordinates", None)
            content["polygon"] = _corners(zone)
        content["name"] = zone.name
        written[place] = WrittenZone(content, place, changed=content != raw[place])
    return [*(written[place] for place in sorted(written)), *new]


def _content(zone: DrawnZone) -> dict[str, Any]:
    kind = {} if zone.kind == "zone" else {"kind": zone.kind}
    return {"name": zone.name, **kind, "polygon": _corners(zone)}


def _corners(zone: DrawnZone) -> list[list[float]]:
    return [[_rounded(x), _rounded(y)] for x, y in zone.polygon or ()]


def _rounded(share: float) -> float:
    value = round(share, _DECIMALS)
    return int(value) if value in (0, 1) else value


def _words_of(invalid: ValidationError, names: Sequence[str]) -> str:
    """Return the first fault as a sentence, with the zone that it is about."""
    first = invalid.errors()[0]
    words = words_of(first)
    place = first["loc"][1] if first["loc"][:1] == ("zones",) and len(first["loc"]) > 1 else None
    if isinstance(place, int) and place < len(names):
        words = f"{names[place]}: {words}"
    return f"{words[0].upper()}{words[1:]}."


def _says(text: str, meant: Mapping[str, Any]) -> bool:
    try:
        return bool(yaml.safe_load(text) == meant)
    except (yaml.YAMLError, ValueError, TypeError):
        return False


def _replace(path: Path, before: str, text: str) -> None:
    """Replace a file, whose owner and mode it keeps, if it still says what it said before."""
    draft = temporary_path(path)
    try:
        status = path.stat()
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(text.encode())
            os.fchmod(file.fileno(), status.st_mode & 0o7777)
            if (status.st_uid, status.st_gid) != (os.geteuid(), os.getegid()):
                os.fchown(file.fileno(), status.st_uid, status.st_gid)
        if path.read_bytes() != before.encode():
            raise ConfigError("Somebody else is changing the file; reload the page.")
        publish([path])
    except OSError as error:
        raise ConfigError(
            f"{path.name} cannot be written: {error.strerror}. The user that the run belongs to needs to own "
            "the file, and to be allowed to write to its folder."
        ) from None
    finally:
        with suppress(OSError):
            draft.unlink()
