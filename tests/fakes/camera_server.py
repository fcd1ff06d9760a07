"""Network cameras for the tests: real ones, of GStreamer's RTSP server, where the system has it."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

__all__ = ["PASSWORD", "camera", "free_port", "needs_rtsp_server"]

PASSWORD = "hunter2"

# GStreamer's bindings belong to the system's Python.
_PYTHON = "/usr/bin/python3"


def _has_rtsp_server() -> bool:
    probe = "import gi; gi.require_version('GstRtspServer', '1.0')"
    try:
        return subprocess.run([_PYTHON, "-c", probe], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


needs_rtsp_server = pytest.mark.skipif(
    not _has_rtsp_server(),
    reason="needs GStreamer's RTSP server (Debian: python3-gi gir1.2-gst-rtsp-server-1.0 "
    "gstreamer1.0-plugins-base gstreamer1.0-plugins-good)",
)


# GStreamer's numbers of transports.
_UDP, _TCP = 1, 4


@contextmanager
def camera(port: int, *, has_tcp: bool = True) -> Iterator[None]:
    """Be rtsp://bob:PASSWORD@127.0.0.1:PORT/door, and gone without a word at the end of the block."""
    program = Path(__file__).with_name("rtsp_camera.py")
    server = subprocess.Popen(
        [_PYTHON, program, str(port), "bob", PASSWORD, str(_UDP | _TCP if has_tcp else _UDP)],
        stdout=subprocess.PIPE,
        text=True,
    )
    with server:
        try:
            assert server.stdout is not None
            assert server.stdout.readline() == "ready\n"
            yield
        finally:
            server.kill()


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
