"""Threads that Ray has in every process look round less often.

In each process a dozen threads of Ray and gRPC ask several times a second whether they are to end, even where
nothing happens: 1.6 ms of CPU time a second. What they really wait for wakes them at once. Eight streams have
sixty processes, whose threads took a twelfth of the time that their frames take on two cores, most of it by
what each look pushes out of the caches.

A timer of Linux may come late by its thread's *slack*. The slack of another thread than its own may be set by
who has ``CAP_SYS_NICE`` only, root on most machines and not in most containers; for others the threads look
round as before.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

__all__ = ["SLACK_SECONDS", "relax_thread_timers"]

#: By how much the timers of these threads may come late, s.
SLACK_SECONDS = 5.0


def relax_thread_timers() -> None:
    """Let the timers of all threads of this process but the calling one come late.

    Call it before threads of one's own are started: those keep the time as their starter does.
    """
    own = threading.get_native_id()
    nanoseconds = round(1e9 * SLACK_SECONDS)
    for thread in Path("/proc/self/task").iterdir():
        if int(thread.name) != own:
            with suppress(OSError):  # it has ended, or this user may not
                Path(f"/proc/{thread.name}/timerslack_ns").write_bytes(b"%d" % nanoseconds)
