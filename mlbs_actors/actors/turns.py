"""Who may work on frames at once, where a node has more streams than cores.

Processes of many streams that take turns every few milliseconds find each other's data in the caches: with
eight streams on two cores a frame took a quarter more CPU time. So streams take turns of a whole burst.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from threading import Lock
from typing import Any, TypeVar

__all__ = ["Turns"]

Answer = TypeVar("Answer")


class Turns:
    """Lets a number of calls be under way; the others wait, in the order in which they came.

    Parameters
    ----------
    most : int
        Calls under way at once.
    """

    def __init__(self, most: int) -> None:
        self._free = most
        self._waiting: deque[Callable[[], None]] = deque()
        self._lock = Lock()

    def take(self, begin: Callable[[], Future[Answer]]) -> Future[Answer]:
        """Have ``begin`` called as soon as it is its turn; return what its future will have.

        The turn is over when that future is done.
        """
        answer: Future[Answer] = Future()

        def start() -> None:
            try:
                begun = begin()
            except Exception as error:
                self._pass_on()
                answer.set_exception(error)
            else:
                begun.add_done_callback(end)

        def end(begun: Future[Any]) -> None:
            self._pass_on()
            error = begun.exception()
            if error is None:
                answer.set_result(begun.result())
            else:
                answer.set_exception(error)

        with self._lock:
            if self._free == 0:
                self._waiting.append(start)
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
