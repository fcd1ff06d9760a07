"""What the monitor answers to the page on which zones are drawn: ``/zones/NAME`` and ``/zones/NAME.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from email.message import Message
from http import HTTPStatus
from pathlib import Path
from typing import Annotated
from urllib.parse import quote, urlsplit

from PIL import Image
from pydantic import Field, ValidationError

from mlbs_actors.errors import ConfigError
from orchestrator.events.object_filter import Strict
from orchestrator.events.zones import Zone
from orchestrator.monitor.address import TOKEN_VARIABLE
from orchestrator.monitor.board import Board
from orchestrator.run.edit_zones import DrawnZone, ZoneEditor
from orchestrator.yaml_file import words_of

__all__ = ["MOST_BYTES", "ZONES_FILES", "ZonesAnswer", "ZonesPage"]

#: Files that the page loads, as those of the live page.
ZONES_FILES = {
    "/zones.js": ("zones.js", "text/javascript; charset=utf-8"),
    "/zone_shapes.js": ("zone_shapes.js", "text/javascript; charset=utf-8"),
    "/zone_words.js": ("zone_words.js", "text/javascript; charset=utf-8"),
    "/zones.css": ("zones.css", "text/css; charset=utf-8"),
}
MOST_BYTES = 1 << 18  # of what is sent here

_FOLDER = Path(__file__).parent
_TEXT = "text/plain; charset=utf-8"
_NO_EDITING = (
    f"Zones can only be looked at: to draw them, set {TOKEN_VARIABLE} to at least 16 characters where the "
    "run is started, for example with openssl rand -hex 16, and open the live page with ?token=… in its "
    "address."
)
_WATCHED = "The run follows what is saved within seconds."
_NOT_WATCHED = (
    "What is saved counts from the next start of the run; with --watch the run follows it within seconds."
)


class _Drawing(Strict):
    zones: Annotated[tuple[DrawnZone, ...], Field(max_length=200)]
    version: str


@dataclass(frozen=True, slots=True)
class ZonesAnswer:
    """An answer to a request.

    Attributes
    ----------
    status : HTTPStatus
    content : bytes
    kind : str
        Media type of the content.
    """

    status: HTTPStatus
    content: bytes
    kind: str = _TEXT


class ZonesPage:
    """Shows the zones of streams, and takes those that were drawn.

    Parameters
    ----------
    board : Board
    editor : ZoneEditor
    may_write : bool
        Whether there is a token, without which nothing is ever written.
    """

    def __init__(self, board: Board, editor: ZoneEditor, *, may_write: bool) -> None:
        self._board = board
        self._editor = editor
        self._may_write = may_write

    def get(self, path: str) -> ZonesAnswer | None:
        """Return the page of a stream, or its zones; None if the path names neither."""
        if (name := self._board.stream_in(path, "/zones/", ".json")) is not None:
            content = json.dumps(self._zones(name)).encode()
            return ZonesAnswer(HTTPStatus.OK, content, "application/json")
        if self._board.stream_in(path, "/zones/", "") is not None:
            return ZonesAnswer(
                HTTPStatus.OK, (_FOLDER / "zones.html").read_bytes(), "text/html; charset=utf-8"
            )
        return None

    def put(self, path: str, headers: Message[str, str], body: bytes) -> ZonesAnswer:
        """Write the zones of a stream, for somebody who knows the token.

        Parameters
        ----------
        path : str
            Of the request.
        headers : Message
            Of the request.
        body : bytes
            JSON: ``zones``, as :class:`DrawnZone`, and the ``version`` that was drawn over.
        """
        name = self._board.stream_in(path, "/zones/", ".json")
        if name is None:
            return _refusal(HTTPStatus.NOT_FOUND, "There is nothing here.")
        if not self._may_write:
            return _refusal(HTTPStatus.FORBIDDEN, _NO_EDITING)
        if not _is_from_here(headers):
            return _refusal(HTTPStatus.FORBIDDEN, "Zones are only taken from this page.")
        if headers.get("Content-Type", "").partition(";")[0].strip().lower() != "application/json":
            return _refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "Zones are sent as application/json.")
        try:
            drawing = _Drawing.model_validate_json(body)
        except ValidationError as invalid:
            first = invalid.errors()[0]
            where = ".".join(map(str, first["loc"]))
            words = f"{where + ': ' if where else ''}{words_of(first)}."
            return _refusal(HTTPStatus.UNPROCESSABLE_ENTITY, words)
        try:
            self._editor.write(name, drawing.zones, drawing.version)
        except ConfigError as error:
            return _refusal(HTTPStatus.CONFLICT, str(error))
        return ZonesAnswer(HTTPStatus.OK, json.dumps(self._zones(name)).encode(), "application/json")

    def _zones(self, name: str) -> dict[str, object]:
        """Return what the page shows of a stream.

        Returns
        -------
        dict
            ``stream``; ``pictures``, addresses beside ``/zones/``, the best first; ``size`` of the stream's
            pictures, px, null if it is not known yet; ``zones``, each with ``name``, ``kind``, ``fixed_to``,
            ``polygon`` in shares of that size (null if it is written in px and the size is not known) and the
            names of the ``rules`` that name it; ``version`` of them; ``may_write``; ``note``, a sentence.
        """
        number = next(place for place, state in enumerate(self._board.states) if state.name == name)
        size = _size_of(self._board.still_of(name))
        shown: dict[str, object] = {
            "stream": name,
            "pictures": [f"stills/{quote(name, safe='')}.jpg", f"pictures/{number}.jpg"],
            "size": size,
            "zones": [],
            "version": "",
            "may_write": False,
        }
        try:
            known = self._editor.read(name)
        except ConfigError as error:
            return shown | {"note": str(error)}
        zones = [
            {
                "name": zone.name,
                "kind": zone.kind,
                "fixed_to": zone.fixed_to,
                "polygon": _shares(zone, size),
                "rules": [
                    rule.name for rule in known.rules if zone.name in {place.name for place in rule.places}
                ],
            }
            for zone in known.zones
        ]
        note = (_WATCHED if self._editor.files.watched else _NOT_WATCHED) if self._may_write else _NO_EDITING
        return shown | {
            "zones": zones,
            "version": known.version,
            "may_write": self._may_write,
            "note": note,
        }


def _refusal(status: HTTPStatus, sentence: str) -> ZonesAnswer:
    return ZonesAnswer(status, f"{sentence}\n".encode())


def _is_from_here(headers: Message[str, str]) -> bool:
    """Whether a page of this address sent a request.

    A browser says so by itself, which no page can forge; behind a proxy that tells another host, only in
    ``Sec-Fetch-Site``.
    """
    if site := headers.get("Sec-Fetch-Site"):
        return site == "same-origin"
    origin = urlsplit(headers.get("Origin", "")).netloc.lower()
    return bool(origin) and origin == headers.get("Host", "").lower()


def _size_of(still: Path) -> tuple[int, int] | None:
    try:
        with Image.open(still) as picture:
            return picture.size
    except (OSError, ValueError):
        return None


def _shares(zone: Zone, size: tuple[int, int] | None) -> list[tuple[float, float]] | None:
    if max(max(point) for point in zone.polygon) <= 1:
        return list(zone.polygon)
    return None if size is None else [(x / size[0], y / size[1]) for x, y in zone.polygon]
