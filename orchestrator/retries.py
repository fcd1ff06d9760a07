"""How long to wait until something that is away is tried again."""

from __future__ import annotations

import random

__all__ = ["LONGEST_RETRY_SECONDS", "retry_seconds"]

#: Longest time between two attempts, s.
LONGEST_RETRY_SECONDS = 30.0

_FIRST_RETRY_SECONDS = 0.5


def retry_seconds(failures: int) -> float:
    """Return the time to wait before the next attempt, s.

    It doubles with every failure up to a bound, and is randomised, so that many cameras behind one switch are
    not all tried at once.
    """
    longest = min(_FIRST_RETRY_SECONDS * 2.0 ** min(failures - 1, 16), LONGEST_RETRY_SECONDS)
    return random.uniform(0.5, 1.0) * longest
