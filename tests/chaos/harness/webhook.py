"""A web server that takes a run's events, and can be away."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

__all__ = ["Webhook"]


class Webhook(ThreadingHTTPServer):
    """Notes what it is sent; takes nothing while it is ``away``, and no events of objects in ``refused``."""

    daemon_threads = True

    def __init__(self, port: int = 0) -> None:
        self.events: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.away = False
        self.refused: set[int] = set()
        super().__init__(("127.0.0.1", port), _Answer)
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.server_address[1]}/hook"

    @property
    def ids(self) -> list[str]:
        """Ids of the events, in the order in which they came."""
        return [event["id"] for event in self.events]

    def stop(self) -> None:
        """Free the port."""
        self.shutdown()
        self.server_close()


class _Answer(BaseHTTPRequestHandler):
    server: Webhook

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        event = json.loads(body)
        refused = event.get("object") in self.server.refused
        if not self.server.away and not refused:
            self.server.headers.append(dict(self.headers))
            self.server.events.append(event)
        self.send_response(503 if self.server.away else 422 if refused else 204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        return
