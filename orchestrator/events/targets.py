"""Where events are sent: an MQTT broker or a webhook. Passwords stay in these objects."""

from __future__ import annotations

import base64
import importlib.util
import os
import ssl
import threading
import urllib.error
import urllib.request
from dataclasses import dataclass, field
from http.client import HTTPException
from typing import Any, Protocol
from urllib.parse import unquote, urlsplit, urlunsplit

from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.credentials import MASK, PASSWORD_VARIABLE, mask
from orchestrator.loopback import is_loopback

__all__ = ["DeliveryError", "EventTarget", "RefusedEventError", "Sender", "open_sender", "parse_target"]

#: Longest time until a target has answered, s.
_ANSWER_SECONDS = 10.0

#: Answers of a webhook by which it will never take an event, whenever it comes: conflicting, too large, of
#: the wrong kind, not to be processed; and bad, which can mean the address, too. By others 4xx the address or
#: the password is wrong, for all events.
_REFUSALS, _BAD = frozenset({409, 413, 415, 422}), 400

#: Ports of MQTT brokers where none is given.
_MQTT_PORTS = {"mqtt": 1883, "mqtts": 8883}


class DeliveryError(MlbsError):
    """A target did not take an event."""


class RefusedEventError(DeliveryError):
    """A target will not take this event, but may take others: surely if ``is_certain``."""

    def __init__(self, words: str, *, is_certain: bool) -> None:
        super().__init__(words)
        self.is_certain = is_certain


@dataclass(frozen=True, slots=True)
class EventTarget:
    """Where to send events.

    Attributes
    ----------
    url : str
        Without user and password.
    user, password : str, optional
    """

    url: str = field(repr=False)
    user: str | None = None
    password: str | None = field(default=None, repr=False)

    @property
    def shown(self) -> str:
        """The address without secrets; the path of a webhook mostly is one."""
        parts = urlsplit(self.url)
        return self.url if parts.scheme in _MQTT_PORTS else f"{parts.scheme}://{parts.netloc}/{MASK}"


class Sender(Protocol):
    """An open way to a target."""

    def send(self, event: bytes) -> None:
        """Send one event and wait until it has been accepted.

        Raises
        ------
        DeliveryError
            If it was not; RefusedEventError if it never will be.
        """

    def close(self) -> None:
        """End the connection."""


def parse_target(text: str) -> EventTarget:
    """Read ``mqtt(s)://[user[:password]@]host[:port]/topic`` or an address of HTTP.

    Raises
    ------
    ConfigError
        If it is neither, or the package for MQTT is missing.
    """
    parts = urlsplit(text)
    try:
        port = parts.port
    except ValueError:
        raise ConfigError(f"--events: the port of {mask(text)} is no number up to 65535.") from None
    if parts.scheme not in (*_MQTT_PORTS, "http", "https") or not parts.hostname:
        raise ConfigError(
            "--events takes mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC, or mqtts: for TLS, http://HOST/PATH or "
            f"https://HOST/PATH; not {mask(text)!r}."
        )
    if parts.scheme in _MQTT_PORTS:
        topic = parts.path.strip("/")
        if not topic or "+" in topic or parts.query or parts.fragment:
            raise ConfigError(
                f"--events: {mask(text)} needs a topic behind the host, such as mqtt://HOST/yard/events, "
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


def open_sender(target: EventTarget) -> Sender:
    """Return a sender; it connects with the first event."""
    return _Mqtt(target) if urlsplit(target.url).scheme in _MQTT_PORTS else _Webhook(target)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        """Follow none: a POST would arrive as a GET without its event."""


class _Webhook:
    """Sends each event as a POST of its JSON; any 2xx is an acknowledgement."""

    def __init__(self, target: EventTarget) -> None:
        self._url = target.url
        self._headers = {"Content-Type": "application/json", "User-Agent": "mlbs-actors"}
        if target.user is not None:
            pair = f"{target.user}:{target.password or ''}".encode()
            self._headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"
        # What listens on this machine is not behind the network's proxy.
        host = urlsplit(target.url).hostname or ""
        proxies = [urllib.request.ProxyHandler({})] if is_loopback(host) else []
        self._opener = urllib.request.build_opener(_NoRedirect, *proxies)

    def send(self, event: bytes) -> None:
        request = urllib.request.Request(self._url, event, self._headers, method="POST")
        try:
            with self._opener.open(request, timeout=_ANSWER_SECONDS) as answer:
                answer.read(1 << 16)
        except urllib.error.HTTPError as error:
            error.close()
            words = f"it answers {error.code} {error.reason}"
            if error.code in _REFUSALS or error.code == _BAD:
                raise RefusedEventError(words, is_certain=error.code != _BAD) from None
            raise DeliveryError(words) from None
        except (OSError, HTTPException) as error:
            raise DeliveryError(str(getattr(error, "reason", error)) or type(error).__name__) from None

    def close(self) -> None:
        return


class _Mqtt:
    """Publishes each event with QoS 1 and waits for the broker's acknowledgement."""

    def __init__(self, target: EventTarget) -> None:
        self._target = target
        self._client: Any = None

    def send(self, event: bytes) -> None:
        parts = urlsplit(self._target.url)
        try:
            if self._client is None:
                port = parts.port or _MQTT_PORTS[parts.scheme]
                self._client = self._connected(parts.hostname or "", port, tls=parts.scheme == "mqtts")
            message = self._client.publish(parts.path.strip("/"), event, qos=1)
            message.wait_for_publish(_ANSWER_SECONDS)
            accepted = message.is_published()
        except (OSError, ValueError, RuntimeError) as error:
            self.close()
            raise DeliveryError(str(error) or type(error).__name__) from None
        if not accepted:
            self.close()  # a client of its own for the next try: this one would send it again by itself
            raise DeliveryError("it does not acknowledge")

    def close(self) -> None:
        if self._client is not None:
            self._client.disconnect()
            self._client.loop_stop()
            self._client = None

    def _connected(self, host: str, port: int, *, tls: bool) -> Any:
        # Imported here, because a run without MQTT does not need the package.
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        answered, refused = threading.Event(), []

        def connected(_client: object, _data: object, _flags: object, reason: object, _more: object) -> None:
            if getattr(reason, "is_failure", False):
                refused.append(str(reason))
            answered.set()

        client = Client(CallbackAPIVersion.VERSION2)
        client.on_connect = connected
        if self._target.user is not None:
            client.username_pw_set(self._target.user, self._target.password)
        if tls:
            client.tls_set_context(ssl.create_default_context())
        client.connect(host, port, keepalive=30)
        client.loop_start()
        if answered.wait(_ANSWER_SECONDS) and not refused:
            return client
        client.disconnect()
        client.loop_stop()
        raise OSError(f"it refuses: {refused[0]}" if refused else "it does not answer")
