"""Wall time of the stages of a frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

__all__ = ["timed"]


@contextmanager
def timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    """Add the time of a block to a stage's, ms."""
    start = perf_counter()
    yield
    stage_ms[stage] = stage_ms.get(stage, 0.0) + 1e3 * (perf_counter() - start)
