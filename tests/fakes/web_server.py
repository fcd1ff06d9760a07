"""A web server on this machine whose pages are functions of its test."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

__all__ = ["Page", "page", "web_server"]

#: Answers one request.
Page = Callable[[BaseHTTPRequestHandler], None]


def page(content_type: str | None, *pieces: bytes, status: int = 200, **headers: str) -> Page:
    """Be a page that sends some bytes, piece by piece; ``ETag="1"`` and the like are its headers."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response(status)
        if content_type is not None:
            request.send_header("Content-Type", content_type)
        for name, value in headers.items():
            request.send_header(name.replace("_", "-"), value)
        request.end_headers()
        for piece in pieces:
            request.wfile.write(piece)
            request.wfile.flush()

    return answer


@contextmanager
def web_server(pages: Mapping[str, Page]) -> Iterator[str]:
    """Serve pages by their paths, without queries; yields HOST:PORT."""

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                pages.get(self.path.partition("?")[0], page("text/html", b"gone", status=404))(self)
            except OSError:
                self.close_connection = True  # the other side has gone

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        server.daemon_threads = True
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
