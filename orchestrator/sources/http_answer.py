"""What a camera answers to one request over HTTP.

By the standard library, with the user name and password of the address, basic or digest. They are sent once a
request, since cameras lock accounts, and never to another host. Nothing but HTTP is opened, wherever a
redirection leads.
"""

from __future__ import annotations

import hashlib
import ssl
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from email.message import Message
from http.client import HTTPException, HTTPResponse
from socket import gaierror
from typing import IO
from urllib.parse import quote, unquote, urlsplit, urlunsplit

from mlbs_actors.errors import SourceError
from orchestrator.loopback import is_loopback

__all__ = ["HttpAnswer", "HttpCamera"]

_BLOCK_BYTES = 1 << 16

_SAFE = "%/:=&?~#+!$,;'@()*[]|"

_MEANINGS = {
    401: "user name or password refused (a % in them is written %25 in the address)",
    403: "the user of the address may not see this picture (403); give them the right in the camera",
    404: "there is nothing at this path (404); the camera's manual names the path of its picture or stream",
    407: "the proxy refuses (407); put the camera's host into the environment variable no_proxy",
    503: "it has no room for another viewer (503); end one, or name a stream of lower resolution",
}


class HttpAnswer:
    """The body of an answer and what its header says.

    Parameters
    ----------
    response : HTTPResponse

    Attributes
    ----------
    content_type : str
        In small letters, without parameters; empty if none is stated.
    length : int, optional
        Bytes of the body; None if it has no end that is known.
    version : dict of str to str
        Headers that ask, in the next request, for something newer only.
    """

    def __init__(self, response: HTTPResponse) -> None:
        self._response = response
        headers = response.headers
        self.content_type = (headers.get("Content-Type") or "").partition(";")[0].strip().lower()
        self.length = response.length
        asked = {"If-None-Match": headers.get("ETag"), "If-Modified-Since": headers.get("Last-Modified")}
        self.version = {name: value for name, value in asked.items() if value}

    def read(self) -> bytes:
        """Return what has come, at least a byte; nothing at the end.

        Raises
        ------
        SourceError
            If the connection broke off, or nothing came in time.
        """
        try:
            return self._response.read1(_BLOCK_BYTES)
        except (OSError, HTTPException, ValueError) as error:
            raise SourceError(_reason(error)) from None

    def close(self) -> None:
        """Close the connection."""
        self._response.close()


class HttpCamera:
    """Asks for one address.

    Parameters
    ----------
    url : str
        May hold a user name and a password.
    timeout_s : float
        Longest wait for the connection, and for each part of the answer, s.
    """

    def __init__(self, url: str, timeout_s: float) -> None:
        parts = urlsplit(url)
        user_info, _, host = parts.netloc.rpartition("@")
        user, _, password = user_info.partition(":")
        path, query = (quote(text, safe=_SAFE) for text in (parts.path or "/", parts.query))
        self._url = urlunsplit((parts.scheme, host, path, query, ""))
        self._timeout_s = timeout_s
        passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        if user:
            whole_host = urlunsplit((parts.scheme, host, "/", "", ""))
            passwords.add_password(None, whole_host, unquote(user), unquote(password))
        self._opener = urllib.request.OpenerDirector()
        # What listens on this machine is not behind the network's proxy.
        proxies: dict[str, str] | None = {} if is_loopback(parts.hostname or "") else None
        for handler in (
            urllib.request.ProxyHandler(proxies),
            urllib.request.UnknownHandler(),
            urllib.request.HTTPHandler(),
            urllib.request.HTTPSHandler(context=_any_certificate()),
            urllib.request.HTTPDefaultErrorHandler(),
            urllib.request.HTTPErrorProcessor(),
            _Redirects(),
            _Digest(passwords),
            _Basic(passwords),
        ):
            self._opener.add_handler(handler)

    def get(self, headers: Mapping[str, str] | None = None) -> HttpAnswer | None:
        """Ask; None if there is nothing newer than the headers say.

        Raises
        ------
        SourceError
            If there is no answer, or a refusal; a few words without credentials and without a full stop.
        """
        request = urllib.request.Request(self._url, headers={"User-Agent": "mlbs-actors", **(headers or {})})
        try:
            return HttpAnswer(self._opener.open(request, timeout=self._timeout_s))
        except urllib.error.HTTPError as error:
            error.close()
            if error.code == 304:
                return None
            raise SourceError(_MEANINGS.get(error.code, f"it answers with the error {error.code}")) from None
        except (OSError, HTTPException, ValueError) as error:
            raise SourceError(_reason(error)) from None


def _any_certificate() -> ssl.SSLContext:
    """Trust a camera's own certificate, which nobody else has signed, as libav does."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


class _Redirects(urllib.request.HTTPRedirectHandler):
    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Message, newurl: str
    ) -> urllib.request.Request | None:
        if req.type == "https" and not newurl.startswith("https:"):
            return None  # the password would be sent in the clear
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


_HASHES = {"MD5": hashlib.md5, "SHA": hashlib.sha1, "SHA-256": hashlib.sha256}


class _Digest(urllib.request.HTTPDigestAuthHandler):
    """Takes the first challenge that it understands, and answers it once."""

    def http_error_401(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Message
    ) -> HTTPResponse | None:
        fp.close()  # the next request has a connection of its own
        if req.has_header(self.auth_header):
            return None
        for challenge in headers.get_all("WWW-Authenticate", []):
            scheme, _, text = challenge.partition(" ")
            # The standard library cannot read a field without a value, such as an empty opaque.
            given = [one for one in urllib.request.parse_http_list(text) if one.partition("=")[2]]
            fields = urllib.request.parse_keqv_list(given)
            if scheme.lower() == "digest" and fields.get("algorithm", "MD5") in _HASHES:
                return self.retry_http_digest_auth(req, f"{scheme} {', '.join(given)}")
        return None

    def get_algorithm_impls(self, algorithm: str) -> tuple[Callable[[str], str], Callable[[str, str], str]]:
        def digest(text: str) -> str:
            return _HASHES[algorithm](text.encode()).hexdigest()

        return digest, lambda secret, data: digest(f"{secret}:{data}")


class _Basic(urllib.request.HTTPBasicAuthHandler):
    """Leaves other challenges alone, which are an error of its class."""

    def http_error_401(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Message
    ) -> HTTPResponse | None:
        challenges = headers.get_all("WWW-Authenticate", [])
        if not any(one.lower().startswith("basic") for one in challenges):
            return None
        return super().http_error_401(req, fp, code, msg, headers)  # type: ignore[arg-type]


def _reason(error: Exception) -> str:
    """Describe an error in a few words; its own text may hold the address."""
    inner = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(inner, TimeoutError):
        return "no answer in time"
    if isinstance(inner, ConnectionRefusedError):
        return "Connection refused; check the port, and whether the camera is on"
    if isinstance(inner, gaierror):
        return "its host is unknown; check the name, and that this machine reaches its network"
    if isinstance(inner, OSError) and inner.strerror:
        return inner.strerror
    if isinstance(inner, HTTPException):
        return "the answer is no HTTP, or was cut off"
    return "it cannot be reached"
