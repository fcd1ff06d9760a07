"""SIGINT and SIGTERM: the first asks for a clean end, the second ends at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

from orchestrator.log import Log

__all__ = ["Interruption", "StopAtOnce"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopAtOnce(BaseException):
    """Raised in the main thread by the second signal. No ``except Exception`` may catch it.

    Attributes
    ----------
    signal_number : int
        The signal that came first.
    """

    def __init__(self, signal_number: int) -> None:
        super().__init__(signal_number)
        self.signal_number = signal_number


class Interruption:
    """Records the first signal while its ``with`` block runs; must be entered after ``ray.init``.

    Ray replaces the handler of SIGTERM when it starts. The handlers found on entry are restored on exit.

    Parameters
    ----------
    say : callable, optional
        Receives a message for the user when a signal has come.

    Attributes
    ----------
    signal_number : int, optional
        The signal that came first, if any.
    """

    def __init__(self, say: Callable[[str], None] | None = None) -> None:
        self.signal_number: int | None = None
        self._say = say or Log().say
        self._silent = False
        self._received = threading.Event()
        self._announcer = threading.Thread(target=self._announce, daemon=True)
        self._found: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        self._announcer.start()
        self._found = {number: signal.signal(number, self._receive) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._found.items():
            signal.signal(number, handler)
        self._received.set()
        self._announcer.join()

    def ask(self, number: int) -> None:
        """Ask for a clean end without a word, as if a signal had come."""
        if self.signal_number is None:
            self.signal_number, self._silent = number, True

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.signal_number is not None:
            raise StopAtOnce(self.signal_number)
        self.signal_number = number
        self._received.set()

    def _announce(self) -> None:
        # In a thread of its own: a signal may come in the middle of a print, and a live table overwrites
        # everything that is not printed through its console.
        self._received.wait()
        if self.signal_number is not None and not self._silent:
            self._say("Finishing what was read; a second signal ends the run at once.")
