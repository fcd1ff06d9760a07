"""Where events are sent, and which: an MQTT broker or a webhook. Passwords stay in these objects."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated
from urllib.parse import unquote, urlsplit, urlunsplit

from pydantic import Field

from mlbs_actors.errors import ConfigError
from orchestrator.credentials import MASK, PASSWORD_VARIABLE, mask
from orchestrator.events.event_filter import EventFilter

__all__ = ["MQTT_PORTS", "EventTarget", "TargetEntry", "all_targets", "parse_target", "targets_of"]

#: Ports of MQTT brokers where none is given.
MQTT_PORTS = {"mqtt": 1883, "mqtts": 8883}

#: What may hold a password in an address that cannot be read, even if its scheme was forgotten: all up to the
#: last @.
_USER_INFO = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*://)?.*@", re.DOTALL)


@dataclass(frozen=True, slots=True)
class EventTarget:
    """Where to send events.

    Attributes
    ----------
    url : str
        Without user and password.
    user, password : str, optional
    wanted : EventFilter
        The events that it gets.
    home_assistant : str, optional
        Prefix of the topics by which Home Assistant discovers what a broker has for it.
    """

    url: str = field(repr=False)
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    wanted: EventFilter = field(default_factory=EventFilter)
    home_assistant: str | None = None

    @property
    def key(self) -> str:
        """What tells it from other targets: its address, of which nothing can be read here."""
        return hashlib.sha256(self.url.encode()).hexdigest()[:16]

    @property
    def shown(self) -> str:
        """The address without secrets; the path of a webhook mostly is one."""
        parts = urlsplit(self.url)
        return self.url if parts.scheme in MQTT_PORTS else f"{parts.scheme}://{parts.netloc}/{MASK}"

    @property
    def topic(self) -> str:
        """Of a broker, where the events go."""
        return urlsplit(self.url).path.strip("/")


class TargetEntry(EventFilter):
    """A target as an operator writes it: an address, beside it which events are wanted.

    Attributes
    ----------
    url : str
        As :func:`parse_target` takes it.
    home_assistant : str, optional
        See :class:`EventTarget`.
    """

    url: Annotated[str, Field(min_length=1, repr=False)]
    home_assistant: Annotated[str, Field(pattern=r"^[^+#/]+(/[^+#/]+)*$")] | None = None


def targets_of(entries: Sequence[TargetEntry]) -> tuple[EventTarget, ...]:
    """Return the targets of a list.

    Raises
    ------
    ConfigError
        If an address cannot be used, or stands there twice.
    """
    targets = tuple(_target_of(entry) for entry in entries)
    keys = [target.key for target in targets]
    for place, target in enumerate(targets):
        if target.key in keys[:place]:
            raise ConfigError(f"events: {target.shown} stands there twice; one entry says all that it gets.")
    return targets


def all_targets(first: Sequence[EventTarget], others: Sequence[EventTarget]) -> tuple[EventTarget, ...]:
    """Return the targets of two lists; of two with the same address the last one counts."""
    return tuple({target.key: target for target in (*first, *others)}.values())


def _target_of(entry: TargetEntry) -> EventTarget:
    wanted = EventFilter.model_validate(entry.model_dump(include=set(EventFilter.model_fields)))
    plain = parse_target(entry.url)
    if entry.home_assistant is not None and urlsplit(plain.url).scheme not in MQTT_PORTS:
        raise ConfigError(f"events: home_assistant needs an mqtt:// address; {plain.shown} is none.")
    return EventTarget(plain.url, plain.user, plain.password, wanted, entry.home_assistant)


def parse_target(text: str) -> EventTarget:
    """Read ``mqtt(s)://[user[:password]@]host[:port]/topic`` or an address of HTTP.

    Raises
    ------
    ConfigError
        If it is neither, or the package for MQTT is missing.
    """
    shown = mask(_USER_INFO.sub(rf"\g<1>{MASK}@", text, count=1))
    try:
        parts = urlsplit(text)
    except ValueError:
        raise ConfigError(
            f"--events: {shown} is no address; in a user or password, characters such as [ ] / # are written "
            "as %5B %5D %2F %23."
        ) from None
    try:
        port = parts.port
    except ValueError:
        raise ConfigError(f"--events: the port of {shown} is no number up to 65535.") from None
    if parts.scheme not in (*MQTT_PORTS, "http", "https") or not parts.hostname:
        raise ConfigError(
            "--events takes mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC, or mqtts: for TLS, http://HOST/PATH or "
            f"https://HOST/PATH; not {shown!r}."
        )
    if parts.scheme in MQTT_PORTS:
        topic = parts.path.strip("/")
        if not topic or "+" in topic or parts.query or parts.fragment:
            raise ConfigError(
                f"--events: {shown} needs a topic behind the host, such as mqtt://HOST/yard/events, "
                "without wildcards."
            )
        if importlib.util.find_spec("paho") is None:
            raise ConfigError("--events mqtt://… needs a package: pip install paho-mqtt")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    place = host if port is None else f"{host}:{port}"
    user = None if parts.username is None else unquote(parts.username)
    password = os.environ.get(PASSWORD_VARIABLE) if parts.password is None else unquote(parts.password)
    url = urlunsplit((parts.scheme, place, parts.path, parts.query, ""))
    return EventTarget(url, user, None if user is None else password)
