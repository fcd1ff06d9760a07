"""An open way to a target, by which events are sent one after the other."""

from __future__ import annotations

import base64
import urllib.error
import urllib.request
from collections.abc import Mapping
from http.client import HTTPException
from typing import Protocol
from urllib.parse import quote, urlsplit, urlunsplit

from mlbs_actors.errors import MlbsError
from orchestrator.events.targets import EventTarget
from orchestrator.loopback import is_loopback

__all__ = ["ANSWER_SECONDS", "DeliveryError", "RefusedEventError", "Sender", "Webhook"]

#: Longest time until a target has answered, s.
ANSWER_SECONDS = 10.0

#: Answers of a webhook by which it will never take an event, whenever it comes: conflicting, too large, of
#: the wrong kind, not to be processed; and bad, which can mean the address, too. By others 4xx the address or
#: the password is wrong, for all events.
_REFUSALS, _BAD = frozenset({409, 413, 415, 422}), 400

#: What stands in a path or a query as it is, besides letters and digits.
_SAFE = "%/:=&?~+!$,;'@()*[]|"


class DeliveryError(MlbsError):
    """A target did not take an event."""


class RefusedEventError(DeliveryError):
    """A target will not take this event, but may take others: surely if ``is_certain``."""

    def __init__(self, words: str, *, is_certain: bool) -> None:
        super().__init__(words)
        self.is_certain = is_certain


class Sender(Protocol):
    """An open way to a target; every method waits until the target has accepted what it was sent.

    Raises
    ------
    DeliveryError
        If it has not; RefusedEventError if it never will.
    """

    def send(self, event: bytes) -> None:
        """Send one event, a JSON object."""

    def hold(self, messages: Mapping[str, bytes]) -> None:
        """Have the target hold these messages, by their topics, for whoever comes; and no others."""

    def close(self) -> None:
        """End the connection."""


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        """Follow none: a POST would arrive as a GET without its event."""


class Webhook:
    """Sends each event as a POST of its JSON; any 2xx is an acknowledgement."""

    def __init__(self, target: EventTarget) -> None:
        parts = urlsplit(target.url)
        path, query = (quote(text, safe=_SAFE) for text in (parts.path, parts.query))
        self._url = urlunsplit((parts.scheme, parts.netloc, path, query, ""))
        self._headers = {"Content-Type": "application/json", "User-Agent": "mlbs-actors"}
        if target.user is not None:
            pair = f"{target.user}:{target.password or ''}".encode()
            self._headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"
        # What listens on this machine is not behind the network's proxy.
        proxies = [urllib.request.ProxyHandler({})] if is_loopback(parts.hostname or "") else []
        self._opener = urllib.request.build_opener(_NoRedirect, *proxies)

    def send(self, event: bytes) -> None:
        """Send one event."""
        try:
            request = urllib.request.Request(self._url, event, self._headers, method="POST")
            with self._opener.open(request, timeout=ANSWER_SECONDS) as answer:
                answer.read(1 << 16)
        except urllib.error.HTTPError as error:
            error.close()
            words = f"it answers {error.code} {error.reason}"
            if error.code in _REFUSALS or error.code == _BAD:
                raise RefusedEventError(words, is_certain=error.code != _BAD) from None
            raise DeliveryError(words) from None
        except (OSError, HTTPException, ValueError) as error:  # the last of a host that cannot be one
            raise DeliveryError(str(getattr(error, "reason", error)) or type(error).__name__) from None

    def hold(self, messages: Mapping[str, bytes]) -> None:
        """Do nothing: a webhook holds none."""

    def close(self) -> None:
        """Do nothing: every event has a connection of its own."""
