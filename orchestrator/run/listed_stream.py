"""A stream as it was asked for: its name, its source, and what differs from the command for it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mlbs_actors.errors import ConfigError
from orchestrator.events.targets import EventTarget
from orchestrator.events.zones import EventSettings
from orchestrator.run.file_watch import Stamp
from orchestrator.sources.address import SourceAddress

__all__ = [
    "MAX_NAME_BYTES",
    "RESERVED_NAMES",
    "UNSAFE_CHARACTERS",
    "ListedStream",
    "OwnSettings",
    "StreamsFile",
    "check_name",
]

MAX_NAME_BYTES = 100
RESERVED_NAMES = frozenset({"run.json", "status.json", "report.html", "ray.log", "events-refused.jsonl"})
_RESERVED = re.compile(r"(cameras|zones)-\d{4}\.yaml")
#: What a file's name cannot hold on Windows, and on shares that Windows reads.
UNSAFE_CHARACTERS = frozenset('<>:"|?*')


@dataclass(frozen=True, slots=True)
class OwnSettings:
    """What a file of cameras says of a stream.

    Attributes
    ----------
    options : mapping of str to object
        Values of options by the name of their field in :class:`~orchestrator.options.Arguments`.
    rules : EventSettings, optional
        Zones, and what is asked of objects.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    rules: EventSettings | None = None


@dataclass(frozen=True, slots=True)
class ListedStream:
    """One stream of the list or of the command line.

    Attributes
    ----------
    name : str
        Unique in the run, and a plain file name.
    source : SourceAddress
    line : int, optional
        Line number in the list, from 1; None if it is not from a list.
    own : OwnSettings
    was : str, optional
        Its name before, under which the run may hold its record.
    """

    name: str
    source: SourceAddress
    line: int | None
    own: OwnSettings = field(default_factory=OwnSettings)
    was: str | None = None

    def is_like(self, other: ListedStream) -> bool:
        """Whether it differs from another one at most by its line."""
        return replace(self, line=None) == replace(other, line=None)


@dataclass(frozen=True, slots=True)
class StreamsFile:
    """What a list of streams or a file of cameras says.

    Attributes
    ----------
    streams : tuple of ListedStream
        Those that can be used.
    faults : dict of int to str
        Number of each line that cannot be used → what is wrong with it, without credentials.
    text : str, optional
        Of a file of cameras.
    targets : tuple of EventTarget, optional
        Where it has events sent; None if that is not known.
    stamp : Stamp, optional
        Of the file as it was read, if that is known.
    """

    streams: tuple[ListedStream, ...]
    faults: dict[int, str]
    text: str | None = field(default=None, repr=False)
    targets: tuple[EventTarget, ...] | None = ()
    stamp: Stamp | None = None


def check_name(name: str, *, given: bool) -> None:
    """Raise ConfigError if a name cannot be that of a stream's folder.

    Parameters
    ----------
    name : str
    given : bool
        Whether somebody chose it, for the advice.
    """
    advice = "choose another name" if given else "give it a name by writing NAME SOURCE"
    if not name or "/" in name or "\\" in name or name.startswith((".", "-")) or "***" in name:
        raise ConfigError(f"{name!r} cannot be the name of a stream's folder; {advice}")
    if unsafe := "".join(sorted(UNSAFE_CHARACTERS & set(name))) or (name[-1:] if name[-1] in ". " else ""):
        raise ConfigError(f"the name {name!r} holds {unsafe!r}, which not every disk can store; {advice}")
    if any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
        raise ConfigError(f"the name {name!r} holds a control character; {advice}")
    if len(name.encode()) > MAX_NAME_BYTES:
        raise ConfigError(f"the name is longer than {MAX_NAME_BYTES} bytes; {advice}")
    if name.lower() in RESERVED_NAMES or _RESERVED.fullmatch(name.lower()):
        raise ConfigError(f"{name!r} is the name of a file of the run; {advice}")
