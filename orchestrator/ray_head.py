"""Ray's own processes on this machine, out of reach of signals that a shell sends to the command's group.

Ctrl-C, ``timeout`` and a closing terminal signal every process of a group. Ray's processes would end first,
and the command could not write what is still in them. So they are started by a process in a session of its
own, which ends them when the command asks for it, and when the command is gone.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mlbs_actors.errors import MlbsError
from orchestrator.module_path import PACKAGE_ROOT

__all__ = ["ray_head"]

#: How long Ray's processes may take to end before they are killed, s.
_END_SECONDS = 20.0


@contextmanager
def ray_head(scratch: Path, options: Mapping[str, Any]) -> Iterator[str]:
    """Run Ray's processes while the ``with`` block runs.

    Parameters
    ----------
    scratch : Path
        Folder for what they print.
    options : mapping of str to object
        Of ``ray.init``, as far as they concern the whole session.

    Yields
    ------
    str
        The address to join, ``HOST:PORT``.

    Raises
    ------
    MlbsError
        If Ray does not start; the message is Ray's.
    """
    with (
        (scratch / "ray-head.log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-m", __name__, json.dumps(dict(options))],
            cwd=PACKAGE_ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        ) as process,
    ):
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            started = json.loads(process.stdout.readline() or "{}")
            if "address" not in started:
                raise MlbsError(started.get("error", "its first process ended"))
            try:
                yield started["address"]
            finally:
                process.stdin.close()
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_END_SECONDS)
        finally:
            process.kill()  # while it starts Ray, for example; the kernel then kills what it has started


def _serve(options: Mapping[str, Any]) -> None:
    """Start Ray, say where, and end it with standard input."""
    import ray

    # What Ray prints must not be taken for the answer.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        ray.init(address="local", include_dashboard=False, log_to_driver=False, **options)
    except Exception as error:
        print(json.dumps({"error": str(error) or type(error).__name__}), file=answers, flush=True)
        return
    print(json.dumps({"address": ray.get_runtime_context().gcs_address}), file=answers, flush=True)
    sys.stdin.read()
    ray.shutdown()


if __name__ == "__main__":
    _serve(json.loads(sys.argv[1]))
