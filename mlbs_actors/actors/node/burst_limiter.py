"""Limits how many streams work on a burst at once, where a node has more streams than cores.

Processes of many streams that alternate every few milliseconds evict each other's data from the caches: with
eight streams on two cores a frame took a quarter more CPU time. So streams alternate by whole bursts.

A call that takes long must not block the others, as it may hang or wait for its disk: after a while they
continue beside it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from threading import Lock, Timer
from typing import Any, TypeVar

__all__ = ["BurstLimiter"]

Answer = TypeVar("Answer")


class BurstLimiter:
    """Runs a limited number of calls at once, plus those that take too long; the others wait in order.

    Parameters
    ----------
    most : int
        Calls under way at once.
    patience : float
        A call that takes longer does not count any more, s.
    """

    def __init__(self, most: int, patience: float) -> None:
        self._free = most
        self._patience = patience
        self._waiting: deque[Callable[[], None]] = deque()
        self._lock = Lock()

    def submit(
        self, begin: Callable[[], Future[Answer]], while_waiting: Callable[[], None] | None = None
    ) -> Future[Answer]:
        """Call ``begin`` as soon as there is room; return a future with the result of its future.

        The room is free again when that future is done, or after ``patience``. If there is none,
        ``while_waiting`` is called first, once.
        """
        answer: Future[Answer] = Future()

        def start() -> None:
            running = _Running(self._pass_on, self._patience)
            try:
                begun = begin()
            except Exception as error:
                answer.set_exception(error)
                running.end()
            else:
                begun.add_done_callback(partial(end, running))

        def end(running: _Running, begun: Future[Any]) -> None:
            # Deliver the answer first: it must not be lost if the next call cannot begin.
            error = begun.exception()
            if error is None:
                answer.set_result(begun.result())
            else:
                answer.set_exception(error)
            running.end()

        with self._lock:
            if self._free == 0:
                self._waiting.append(start)
                if while_waiting is not None:
                    while_waiting()  # under the lock, so that the call cannot start before
                return answer
            self._free -= 1
        start()
        return answer

    def _pass_on(self) -> None:
        with self._lock:
            if not self._waiting:
                self._free += 1
                return
            following = self._waiting.popleft()
        following()


class _Running:
    """A call under way. It makes room once: at its end, or when it has taken too long."""

    def __init__(self, pass_on: Callable[[], None], patience: float) -> None:
        self._pass_on = pass_on
        self._over = False
        self._lock = Lock()
        self._timer = Timer(patience, self.end)
        self._timer.daemon = True
        with suppress(RuntimeError):  # no thread is available: a call without time limit is better than none
            self._timer.start()

    def end(self) -> None:
        self._timer.cancel()
        with self._lock:
            if self._over:
                return
            self._over = True
        self._pass_on()
