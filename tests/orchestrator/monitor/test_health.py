"""The health check of the image: it asks the page, if there is one."""

from __future__ import annotations

import socket
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest

from orchestrator.monitor import health
from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.monitor.board import Board
from orchestrator.monitor.server import serving


def test_a_page_that_answers_is_healthy_without_its_token(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "a-token-of-the-tests")
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # is not for this machine
    with serving(MonitorAddress("0.0.0.0", 0), Board(tmp_path, tmp_path / "out", list)) as url:
        assert health.main(url.split(":")[2].partition("/")[0]) == 0


def test_a_command_without_a_page_is_healthy() -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    assert health.main(str(port)) == 0


def test_a_page_that_hangs_or_fails_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "_SECONDS", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        assert health.main(str(silent.getsockname()[1])) == 1

    class Failing(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_error(503)

        def log_message(self, *_: object) -> None:
            return

    with HTTPServer(("127.0.0.1", 0), Failing) as server:
        thread = Thread(target=server.handle_request)
        thread.start()
        assert health.main(str(server.server_port)) == 1
        thread.join()
