"""How quickly a stream is read, and the CPU time that it takes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from mlbs_actors.actors.stream.protocol import StreamProgress

__all__ = ["LoadMeter", "StreamLoad"]

#: Window of the measurement, s: most and, for rate and load, least. The first bursts of a stream are slow.
_MOST_SECONDS, _LEAST_RATE_SECONDS, _LEAST_LOAD_SECONDS = 10.0, 2.0, 5.0


@dataclass(frozen=True, slots=True)
class StreamLoad:
    """Load of a stream over the last seconds.

    Attributes
    ----------
    frames_per_second : float
        Rate at which frames are read; 0 while it is unknown.
    cores : float, optional
        Cores that would be busy if every frame read were labelled: CPU time of a label map times the rate.
        None while it is unknown.
    """

    frames_per_second: float = 0.0
    cores: float | None = None


@dataclass(frozen=True, slots=True)
class _Sample:
    seconds: float
    read: int
    labelled: int
    cpu_seconds: float


class LoadMeter:
    """Measures the load of one start of a stream.

    Parameters
    ----------
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._samples: deque[_Sample] = deque()
        # Those at which frames had been read, so that a camera that stops does not seem to take less.
        self._busy: deque[_Sample] = deque()

    def after(self, progress: StreamProgress) -> StreamLoad:
        """Add the counts so far; return the load."""
        labelled = progress.read - progress.dropped - progress.quarantined
        sample = _Sample(self._clock(), progress.read, labelled, progress.cpu_seconds)
        _append(self._samples, sample)
        if progress.silence is not None and progress.silence.state is not None:
            self._busy.clear()
        elif not self._busy or sample.read > self._busy[-1].read:
            _append(self._busy, sample)
        return StreamLoad(_rate(self._samples, _LEAST_RATE_SECONDS), self._cores())

    def _cores(self) -> float | None:
        rate = _rate(self._busy, _LEAST_LOAD_SECONDS)
        if not rate or (labelled := self._busy[-1].labelled - self._busy[0].labelled) <= 0:
            return None
        return rate * (self._busy[-1].cpu_seconds - self._busy[0].cpu_seconds) / labelled


def _append(samples: deque[_Sample], sample: _Sample) -> None:
    samples.append(sample)
    while len(samples) > 2 and samples[0].seconds < sample.seconds - _MOST_SECONDS:
        samples.popleft()


def _rate(samples: deque[_Sample], least_seconds: float) -> float:
    """Return the frames read a second between the first and the last sample; 0 if they are too close."""
    if not samples or (seconds := samples[-1].seconds - samples[0].seconds) < least_seconds:
        return 0.0
    return (samples[-1].read - samples[0].read) / seconds
