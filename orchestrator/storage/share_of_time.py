"""Work that is done again and again, but takes no more than a share of the time however long it lasts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["ShareOfTime"]


class ShareOfTime:
    """Tells when such work is due.

    Parameters
    ----------
    share : float
        Of the time, that it may take.
    least_seconds : float
        Least time from its end until it is due again, s.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self, share: float, least_seconds: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._share = share
        self._least_seconds = least_seconds
        self._clock = clock
        self._due = -float("inf")

    @property
    def is_due(self) -> bool:
        """Whether the work may be done now; at first it may."""
        return self._clock() >= self._due

    @contextmanager
    def spent(self) -> Iterator[None]:
        """Count what the block takes; an error in it leaves the work due as it was."""
        begun = self._clock()
        yield
        ended = self._clock()
        self._due = ended + max(self._least_seconds, (ended - begun) / self._share)
