"""The actor that keeps the results of a run from their commit until the program takes them.

Each result is offered before its commit and settled after it, so that a process may be lost at any moment: a
result that was offered only is offered again by the stream, which goes back to its snapshot; one that was
committed is here. Results are numbered in each stream, and every number is handed out once.
"""

from __future__ import annotations

import asyncio
import pickle
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from mlbs_actors.errors import SinkError

__all__ = ["Numbered", "PickledResult", "ResultQueue"]

#: A pickled result with its number in its stream.
Numbered = tuple[int, bytes]


class PickledResult:
    """A result on its way: whoever receives this, receives the result.

    Parameters
    ----------
    pickled : bytes
    """

    def __init__(self, pickled: bytes) -> None:
        self._pickled = pickled

    def __reduce__(self) -> tuple[Any, ...]:
        """Become the result where it is unpickled."""
        return pickle.loads, (self._pickled,)


@dataclass(slots=True)
class _Stream:
    """One stream's results: the number of the next one to be settled, and those offered by then."""

    next: int = 0
    start: int = 0
    offered: dict[int, bytes] = field(default_factory=dict)


class ResultQueue:
    """Keeps results; its methods run in one thread, between whose ``await`` s others may run."""

    def __init__(self) -> None:
        self._streams: dict[str, _Stream] = {}
        self._ready: deque[tuple[str, bytes]] = deque()
        self._news = asyncio.Event()

    async def open(self, name: str, committed: int) -> int:
        """Begin to take a stream's results from this number on, as those before are committed.

        Returns
        -------
        int
            The number of this start of the stream, for its other calls.
        """
        stream = self._streams.setdefault(name, _Stream())
        stream.start += 1
        self._settle(name, stream, committed)
        stream.next = max(stream.next, committed)
        stream.offered.clear()  # the stream says them again
        return stream.start

    async def offer(self, name: str, start: int, results: Sequence[Numbered]) -> None:
        """Take results that are not committed yet; those that were settled before are skipped."""
        stream = self._stream(name, start)
        stream.offered.update((number, one) for number, one in results if number >= stream.next)

    async def settle(self, name: str, start: int, committed: int) -> None:
        """Make the results before this number ready, as they are committed."""
        self._settle(name, self._stream(name, start), committed)

    async def ready(self, seconds: float) -> list[str]:
        """Return the streams of the results that can be taken; wait up to this time for the first, s."""
        if not self._ready:
            self._news.clear()
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), seconds)
        return [name for name, _ in self._ready]

    async def take(self, most: int, seconds: float) -> list[PickledResult]:
        """Take the oldest results; wait up to this time for the first, s."""
        await self.ready(seconds)
        return [await self.take_one() for _ in range(min(most, len(self._ready)))]

    async def take_one(self) -> PickledResult:
        """Take the oldest result, which must be there."""
        return PickledResult(self._ready.popleft()[1])

    def _stream(self, name: str, start: int) -> _Stream:
        stream = self._streams[name]
        if stream.start != start:
            raise SinkError(f"The stream {name} has been started again since; this start of it is over.")
        return stream

    def _settle(self, name: str, stream: _Stream, committed: int) -> None:
        while stream.next < committed and stream.next in stream.offered:
            self._ready.append((name, stream.offered.pop(stream.next)))
            stream.next += 1
            self._news.set()
