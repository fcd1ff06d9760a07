"""As much of an MQTT 3.1.1 broker as a publisher with QoS 1 needs."""

from __future__ import annotations

import socket
import socketserver
import struct
import threading
from contextlib import suppress
from typing import Any

__all__ = ["Broker"]


class Broker(socketserver.ThreadingTCPServer):
    """A broker that serves until it is stopped; refuses other passwords than ``s3cret``.

    Parameters
    ----------
    port : int
        0 for a free one.

    Attributes
    ----------
    published : list of (str, bytes)
        Topics and payloads, in the order of their arrival.
    """

    allow_reuse_address = daemon_threads = True

    def __init__(self, port: int = 0) -> None:
        self.published: list[tuple[str, bytes]] = []
        self.clients: list[Any] = []
        super().__init__(("127.0.0.1", port), _Session)
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    def stop(self) -> None:
        """Close the port and all connections."""
        self.shutdown()
        self.server_close()
        for client in self.clients:
            with suppress(OSError):  # it has gone by itself
                client.shutdown(socket.SHUT_RDWR)


class _Session(socketserver.StreamRequestHandler):
    server: Broker

    def handle(self) -> None:
        self.server.clients.append(self.connection)
        try:
            while first := self.rfile.read(1):
                self._answer(first[0] >> 4, self.rfile.read(self._length()))
        except (OSError, ValueError):
            return

    def _length(self) -> int:
        length = shift = 0
        while True:
            byte = self.rfile.read(1)[0]
            length |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return length

    def _answer(self, kind: int, body: bytes) -> None:
        if kind == 1:
            self.wfile.write(bytes([0x20, 2, 0, 0 if body.endswith(b"s3cret") else 5]))
        elif kind == 3:
            (size,) = struct.unpack_from(">H", body)
            topic, number = body[2 : 2 + size].decode(), body[2 + size : 4 + size]
            self.server.published.append((topic, body[4 + size :]))
            self.wfile.write(bytes([0x40, 2]) + number)
