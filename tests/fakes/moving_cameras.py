"""Network cameras of one server, each with a password of its own, that show something walk to and fro."""

from __future__ import annotations

import time
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count
from threading import Thread

import cv2
import numpy as np

__all__ = ["MovingCameras", "moving_cameras"]

#: Pictures a second, and of one walk; width and height, px.
_RATE, _WALK = 10, 80
_SIZE = (320, 240)


def _pictures() -> list[bytes]:
    rng = np.random.default_rng(1)
    ground = cv2.resize(rng.integers(40, 200, (60, 80, 3), np.uint8), _SIZE, interpolation=cv2.INTER_CUBIC)
    walker = cv2.resize(rng.integers(0, 255, (6, 4, 3), np.uint8), (40, 60), interpolation=cv2.INTER_NEAREST)
    pictures = []
    for step in range(_WALK):
        picture = ground.copy()
        left = 20 + 3 * min(step, _WALK - step) * 2
        picture[100:160, left : left + 40] = walker
        pictures.append(cv2.imencode(".jpg", picture)[1].tobytes())
    return pictures


class MovingCameras:
    """The cameras.

    Parameters
    ----------
    port : int
    passwords : dict of str to str
        Name of each camera → the password of its user bob; changed as the test likes.
    """

    def __init__(self, port: int, passwords: dict[str, str]) -> None:
        self._port = port
        self.passwords = passwords

    def address(self, name: str, password: str | None = None) -> str:
        """Return the address of a camera, with its password or another one."""
        return f"http://bob:{password or self.passwords[name]}@127.0.0.1:{self._port}/{name}"


@contextmanager
def moving_cameras(**passwords: str) -> Iterator[MovingCameras]:
    """Serve cameras until the end of the block."""
    pictures = _pictures()

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            password = passwords.get(self.path.strip("/"))
            login = "Basic " + b64encode(f"bob:{password}".encode()).decode()
            if password is None or self.headers["Authorization"] != login:
                self.send_response(404 if password is None else 401)
                self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                self.end_headers()
                return
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=part")
            self.end_headers()
            began = time.monotonic()
            for number in count(int(time.time() * _RATE)):
                time.sleep(max(0.0, began + 1 / _RATE - time.monotonic()))
                began += 1 / _RATE
                jpeg = pictures[number % _WALK]
                head = f"--part\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
                except OSError:
                    return

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        server.daemon_threads = True
        Thread(target=server.serve_forever, daemon=True).start()
        yield MovingCameras(server.server_port, passwords)
        server.shutdown()
