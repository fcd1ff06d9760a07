"""SIGINT and SIGTERM until the run has its own handlers.

They unwind the stack, so that a Ray that is just starting is ended too.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType

__all__ = ["exit_if_signalled", "exit_on_signals"]

#: The signal that came, if any; a list, as a handler returns nothing.
_received: list[int] = []


def exit_on_signals() -> None:
    """Let both signals exit the process with the status that shells give them."""
    _received.clear()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _exit)
    sys.unraisablehook = _tell_unless_exiting


def exit_if_signalled() -> None:
    """Exit if a signal has come whose exit was lost.

    Python drops what is raised while it finalises an object or collects garbage, and libraries may catch it.
    """
    if _received:
        raise SystemExit(128 + _received[0])


def _exit(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    exit_if_signalled()


def _tell_unless_exiting(lost: sys.UnraisableHookArgs) -> None:
    if not (_received and issubclass(lost.exc_type, SystemExit)):
        sys.__unraisablehook__(lost)
