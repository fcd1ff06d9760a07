"""Starts Ray on this machine and ends it with standard input; run by :mod:`orchestrator.ray_head`.

It imports nothing but Ray, since a run waits for it.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__: list[str] = []


def _serve(options: dict[str, Any]) -> None:
    """Start Ray, say where, and end it with standard input, also while it starts."""
    # Whoever ends a service may signal all of its processes. Ray's inherit this: they stay until the command
    # has committed what they hold, and asks for their end.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    watch = threading.Thread(target=_end_with_input)
    watch.start()
    import ray

    # What Ray prints must not be taken for the answer.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        ray.init(address="local", include_dashboard=False, log_to_driver=False, **options)
        answer = {"address": ray.get_runtime_context().gcs_address}
    except Exception as error:
        answer = {"error": str(error) or type(error).__name__}
    print(json.dumps(answer), file=answers, flush=True)
    watch.join()


def _end_with_input() -> None:
    """End every process of this session when standard input ends.

    Ray's own way asks each of its processes by SIGTERM, one after the other, and waits a second for it.
    """
    sys.stdin.read()
    ended = {os.getpid()}
    while others := _processes_of_session() - ended:  # until none has started another one meanwhile
        for number in others:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        ended |= others
    os._exit(0)


def _processes_of_session() -> set[int]:
    found = set()
    for path in Path("/proc").iterdir():
        with suppress(ValueError, ProcessLookupError):  # no process, or one that has ended
            if os.getsid(int(path.name)) == os.getpid():
                found.add(int(path.name))
    return found


if __name__ == "__main__":
    _serve(json.loads(sys.argv[1]))
