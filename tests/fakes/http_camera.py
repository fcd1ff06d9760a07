"""A network camera on this machine that sends MJPEG over HTTP."""

from __future__ import annotations

import time
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import cv2
import numpy as np

__all__ = ["PICTURES", "http_camera"]

#: Of one connection, twenty a second.
PICTURES = 25

_LOGIN = "Basic " + b64encode(b"bob:hunter2").decode()


class _Answers(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.headers["Authorization"] != _LOGIN:
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="camera"')
            self.end_headers()
        elif self.path == "/page":
            page = b"<html>no video</html>" * 100
            self.send_response(200)
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)
        else:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=part")
            self.end_headers()
            for number in range(PICTURES):
                _, jpeg = cv2.imencode(".jpg", np.full((120, 160, 3), 9 * number, np.uint8))
                head = f"--part\r\nContent-Type: image/jpeg\r\nContent-Length: {jpeg.size}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg.tobytes() + b"\r\n")
                time.sleep(0.05)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def http_camera() -> Iterator[str]:
    """Be bob:hunter2's camera; yields its HOST:PORT. Every path but /page is the video."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _Answers) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()
