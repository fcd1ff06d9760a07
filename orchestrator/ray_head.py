"""Ray's own processes on this machine, out of reach of signals that are meant for the command.

Ctrl-C, ``timeout`` and a closing terminal signal every process of a group, a service manager every process of
a service. Ray's processes would end first, and the command could not write what is still in them. So they are
started by a process in a session of its own (:mod:`orchestrator.ray_processes`), which holds SIGTERM off
them, and ends them when the command asks for it, and when the command is gone.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mlbs_actors.errors import MlbsError
from orchestrator.module_path import PACKAGE_ROOT

__all__ = ["RayHead", "ray_head"]

#: How long Ray's processes may take to end before they are killed, s.
_END_SECONDS = 20.0


class RayHead:
    """Ray's processes, which may be starting still; made by :func:`ray_head`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def address(self) -> str:
        """Wait until Ray has started; return the address to join, ``HOST:PORT``.

        Raises
        ------
        MlbsError
            If Ray does not start; the message is Ray's.
        """
        assert self._process.stdout is not None
        started = json.loads(self._process.stdout.readline() or "{}")
        if "address" not in started:
            raise MlbsError(started.get("error", "its first process ended"))
        return str(started["address"])

    def begin_to_end(self) -> None:
        """Have Ray end, without waiting for it; may be called twice."""
        assert self._process.stdin is not None
        self._process.stdin.close()


@contextmanager
def ray_head(scratch: Path, options: Mapping[str, Any]) -> Iterator[RayHead]:
    """Run Ray's processes while the ``with`` block runs; they start in parallel with it.

    Parameters
    ----------
    scratch : Path
        Folder for what they print.
    options : mapping of str to object
        Of ``ray.init``, as far as they concern the whole session.
    """
    with (
        (scratch / "ray-head.log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-m", "orchestrator.ray_processes", json.dumps(dict(options))],
            cwd=PACKAGE_ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        ) as process,
    ):
        head = RayHead(process)
        try:
            yield head
        finally:
            head.begin_to_end()
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_SECONDS)
            process.kill()  # the kernel then kills what it has started
