"""Who may work on frames at once, where a node has more streams than cores.

Processes of many streams that take turns every few milliseconds find each other's data in the caches: with
eight streams on two cores a frame took a quarter more CPU time. So streams take turns of a whole burst.

A turn that lasts is another matter: what hangs there, or waits for its disk, must not keep the others from
their work. After a while they go on beside it.
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
    """Lets a number of calls be under way, and those that last; the others wait, in their order.

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
        """Have ``begin`` called as soon as it is its turn; return what its future will have.

        The turn is over when that future is done, or after ``patience``. Where it is not its turn yet,
        ``while_waiting`` is called before, once.
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
            # First the answer: it must not be lost where the next call cannot begin.
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
                    while_waiting()  # while nobody can pass the turn on
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
    """A turn that has begun. It is passed on once: at its end, or when it has lasted too long."""

    def __init__(self, pass_on: Callable[[], None], patience: float) -> None:
        self._pass_on = pass_on
        self._over = False
        self._lock = Lock()
        self._timer = Timer(patience, self.end)
        self._timer.daemon = True
        with suppress(RuntimeError):  # no thread is to be had: better a turn without an end than none
            self._timer.start()

    def end(self) -> None:
        self._timer.cancel()
        with self._lock:
            if self._over:
                return
            self._over = True
        self._pass_on()
