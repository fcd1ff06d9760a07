"""The files of streams' records that the monitor serves, and the parts of them that players ask for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from orchestrator.events.file_names import CLIPS, PICTURES

__all__ = ["RecordedFile", "asked_range", "recorded_file"]

_KINDS = {
    PICTURES: (re.compile(r"\d{8,}-\d+\.jpg", re.ASCII), "image/jpeg"),
    CLIPS: (re.compile(r"\d{8,}-[0-9a-f]{8}\.mp4", re.ASCII), "video/mp4"),
}
_RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})", re.ASCII)


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """A file to be served; it may not be there, or not yet.

    Attributes
    ----------
    path : Path
    kind : str
        Its media type.
    """

    path: Path
    kind: str


def recorded_file(run: Path, streams: frozenset[str], path: str) -> RecordedFile | None:
    """Return what ``/records/NAME/`` and a picture or a clip of an event's line name; None for anything else.

    Parameters
    ----------
    run : Path
        Folder of the run.
    streams : frozenset of str
        Names of its streams.
    path : str
        Of the request, percent-encoded.
    """
    parts = unquote(path).removeprefix("/records/").rsplit("/", 2)
    if not path.startswith("/records/") or len(parts) != 3:
        return None
    name, folder, file = parts
    if name not in streams or folder not in _KINDS or not _KINDS[folder][0].fullmatch(file):
        return None
    return RecordedFile(run / name / folder / file, _KINDS[folder][1])


def asked_range(header: str | None, size: int) -> range | None:
    """Return the bytes of a file that a ``Range`` header asks for, none if it has no such bytes.

    None if it asks for no single part, so that all is to be sent.
    """
    found = None if header is None else _RANGE.fullmatch(header.strip())
    if found is None or found[0] == "bytes=-":
        return None
    first, last = found.groups()
    if not first:
        return range(max(size - int(last), 0), size)
    return range(int(first), min(int(last) + 1, size) if last else size)
