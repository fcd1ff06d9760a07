"""An RTMP server on this machine that plays one video, as far as libav's client needs a server."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from threading import Thread

__all__ = ["rtmp_server"]

_HANDSHAKE_BYTES = 1536
_CHUNK_BYTES = 1 << 16  # longer than any message here, so that each is one chunk


def _string(text: str) -> bytes:
    return b"\x02" + struct.pack(">H", len(text)) + text.encode()


def _object(**fields: str) -> bytes:
    names = (struct.pack(">H", len(name)) + name.encode() + _string(text) for name, text in fields.items())
    return b"\x03" + b"".join(names) + b"\x00\x00\x09"


def _number(value: float) -> bytes:
    return b"\x00" + struct.pack(">d", value)


def _message(kind: int, body: bytes, stream: int = 0, milliseconds: int = 0) -> bytes:
    head = struct.pack(">I", milliseconds)[1:] + struct.pack(">I", len(body))[1:]
    return b"\x03" + head + bytes([kind]) + struct.pack("<I", stream) + body


def _until(client: socket.socket, word: bytes) -> None:
    """Receive until a command has come; what else is said does not matter."""
    said = b""
    while word not in said:
        data = client.recv(1 << 16)
        if not data:
            raise OSError("the client has gone")
        said += data


def _play(client: socket.socket, tags: Sequence[tuple[int, int, bytes]]) -> None:
    said = b""
    while len(said) < 1 + _HANDSHAKE_BYTES:
        said += client.recv(1 << 16)
    client.sendall(b"\x03" + bytes(_HANDSHAKE_BYTES) + said[1 : 1 + _HANDSHAKE_BYTES])
    _until(client, b"connect")
    client.sendall(_message(1, struct.pack(">I", _CHUNK_BYTES)))
    connected = _object(level="status", code="NetConnection.Connect.Success")
    client.sendall(_message(20, _string("_result") + _number(1) + _object(fmsVer="1") + connected))
    _until(client, b"createStream")
    client.sendall(_message(20, _string("_result") + _number(2) + b"\x05" + _number(1)))
    _until(client, b"play")
    begun = _object(level="status", code="NetStream.Play.Start")
    client.sendall(_message(20, _string("onStatus") + _number(0) + b"\x05" + begun, stream=1))
    began = time.monotonic()
    for kind, milliseconds, body in tags:
        time.sleep(max(0.0, began + milliseconds / 1000 - time.monotonic()))
        client.sendall(_message(kind, body, 1, milliseconds))


def _tags(flv: bytes) -> list[tuple[int, int, bytes]]:
    """Kind, time in ms and body of each tag."""
    tags, at = [], 13
    while at + 11 <= len(flv):
        length = int.from_bytes(flv[at + 1 : at + 4], "big")
        milliseconds = int.from_bytes(flv[at + 4 : at + 7], "big")
        tags.append((flv[at], milliseconds, flv[at + 11 : at + 11 + length]))
        at += 11 + length + 4
    return [tag for tag in tags if tag[0] in (8, 9)]


@contextmanager
def rtmp_server(flv: bytes) -> Iterator[str]:
    """Play an FLV file to every client at its own speed; yields HOST:PORT."""
    tags = _tags(flv)

    def serve(client: socket.socket) -> None:
        with client, suppress(OSError):
            _play(client, tags)

    def listen() -> None:
        with suppress(OSError):  # the listener was closed
            while True:
                Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        Thread(target=listen, daemon=True).start()
        yield f"127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)
