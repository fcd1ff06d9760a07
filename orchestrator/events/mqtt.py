"""A connection to an MQTT broker, for the events and for what Home Assistant finds there."""

from __future__ import annotations

import json
import ssl
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from orchestrator.events.home_assistant import OFFLINE, HomeAssistant, states_of
from orchestrator.events.senders import ANSWER_SECONDS, DeliveryError
from orchestrator.events.targets import MQTT_PORTS, EventTarget

__all__ = ["Mqtt"]

#: How long an end in order may take, s.
_FAREWELL_SECONDS = 1.0

#: Between two looks at whether the connection has ended, s.
_LOOK_SECONDS = 0.1


class Mqtt:
    """Publishes with QoS 1 and waits for the broker's acknowledgement; connects with the first message.

    Parameters
    ----------
    target : EventTarget
    home : HomeAssistant, optional
        What it is told besides the events.
    """

    def __init__(self, target: EventTarget, home: HomeAssistant | None = None) -> None:
        self._target = target
        self._home = home
        self._client: Any = None
        self._held: dict[str, bytes] = {}
        # What the broker held before: of each topic of discovery, that and those of the entity's states. The
        # client's own thread replaces it.
        self._found: dict[str, set[str]] = {}
        self._emptied: set[str] = set()

    def send(self, event: bytes) -> None:
        """Publish one event."""
        messages = [(self._target.topic, event)]
        if self._home is not None:
            messages += self._home.messages(json.loads(event))
        self._publish(messages, retain=False)

    def hold(self, messages: Mapping[str, bytes]) -> None:
        """Publish what has changed of the retained messages, or all if the connection is new."""
        self._connect()  # it may be a new one, which has held nothing
        known = messages.keys() | self._emptied
        earlier = {topic for found, states in self._found.items() if found not in known for topic in states}
        gone = (self._held.keys() | earlier) - messages.keys()
        changed = [(topic, text) for topic, text in messages.items() if self._held.get(topic) != text]
        self._publish([*changed, *((topic, b"") for topic in sorted(gone))], retain=True)
        self._emptied |= gone
        self._held = dict(messages)

    def close(self) -> None:
        """End the connection, and say so to whoever looks at the status."""
        client, self._client = self._client, None
        if client is None:
            return
        if self._home is not None and self._home.status in self._held and client.is_connected():
            farewell = client.publish(self._home.status, OFFLINE, qos=1, retain=True)
            with suppress(ValueError, RuntimeError):
                _is_accepted(client, farewell, _FAREWELL_SECONDS)
        client.disconnect()
        client.loop_stop()

    def _publish(self, messages: Iterable[tuple[str, bytes]], *, retain: bool) -> None:
        client = self._connect()
        try:
            sent = [client.publish(topic, text, qos=1, retain=retain) for topic, text in messages]
            accepted = all(_is_accepted(client, message, ANSWER_SECONDS) for message in sent)
        except (OSError, ValueError, RuntimeError) as error:
            self.close()
            raise DeliveryError(str(error) or type(error).__name__) from None
        if not accepted:
            self.close()  # a client of its own for the next try: this one would send it again by itself
            raise DeliveryError("it does not acknowledge")

    def _connect(self) -> Any:
        """Return the client; a new one if there is none, or the broker has gone meanwhile."""
        if self._client is not None and not self._client.is_connected():
            self.close()
        if self._client is None:
            try:
                self._client = self._connected()
            except (OSError, ValueError) as error:
                raise DeliveryError(str(error) or type(error).__name__) from None
            self._held, self._emptied = {}, set()
        return self._client

    def _connected(self) -> Any:
        # Imported here, because a run without MQTT does not need the package.
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        answered, refused = threading.Event(), []

        def connected(client: Any, _data: object, _flags: object, reason: object, _more: object) -> None:
            if getattr(reason, "is_failure", False):
                refused.append(str(reason))
            elif self._home is not None:
                client.subscribe(self._home.discovered)
            answered.set()

        def received(_client: object, _data: object, message: Any) -> None:
            if message.retain and message.payload:
                self._found = self._found | {message.topic: {message.topic, *states_of(message.payload)}}

        parts = urlsplit(self._target.url)
        client = Client(CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        client.on_connect, client.on_message = connected, received
        if self._target.user is not None:
            client.username_pw_set(self._target.user, self._target.password)
        if parts.scheme == "mqtts":
            client.tls_set_context(ssl.create_default_context())
        if self._home is not None:
            client.will_set(self._home.status, OFFLINE, qos=1, retain=True)
        self._found = {}
        client.connect(parts.hostname or "", parts.port or MQTT_PORTS[parts.scheme], keepalive=30)
        client.loop_start()
        if answered.wait(ANSWER_SECONDS) and not refused:
            return client
        client.disconnect()
        client.loop_stop()
        raise OSError(f"it refuses: {refused[0]}" if refused else "it does not answer")


def _is_accepted(client: Any, message: Any, seconds: float) -> bool:
    """Wait for the acknowledgement of a message for so long, or until the connection ends."""
    until = time.monotonic() + seconds
    while client.is_connected() and not message.is_published() and time.monotonic() < until:
        message.wait_for_publish(_LOOK_SECONDS)
    return bool(message.is_published())
