"""How quickly a stream is read, and the CPU time that it takes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from mlbs_actors.actors.stream.protocol import StreamProgress

__all__ = ["LoadMeter", "StreamLoad"]

#: Least and most seconds that the rate is measured over. The first bursts of a stream are slow.
_RATE_SECONDS = 2.0, 10.0

#: The same for the load: a stream has its objects only after some seconds, and a scene fills and empties.
_LOAD_SECONDS = 30.0, 60.0


@dataclass(frozen=True, slots=True)
class StreamLoad:
    """How much a stream reads, and takes.

    Attributes
    ----------
    frames_per_second : float
        Rate at which frames are read, of the last ten seconds; 0 while it is unknown.
    cores : float, optional
        Cores that would be busy if every frame read were labelled: CPU time of a label map times the rate,
        of the last minute. None while it is unknown, which is half a minute.
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
        _append(self._samples, sample, _RATE_SECONDS)
        if progress.silence is not None and progress.silence.state is not None:
            self._busy.clear()
        elif not self._busy or sample.read > self._busy[-1].read:
            _append(self._busy, sample, _LOAD_SECONDS)
        return StreamLoad(_rate(self._samples, _RATE_SECONDS), self._cores())

    def _cores(self) -> float | None:
        rate = _rate(self._busy, _LOAD_SECONDS)
        if not rate or (labelled := self._busy[-1].labelled - self._busy[0].labelled) <= 0:
            return None
        return rate * (self._busy[-1].cpu_seconds - self._busy[0].cpu_seconds) / labelled


def _append(samples: deque[_Sample], sample: _Sample, window: tuple[float, float]) -> None:
    samples.append(sample)
    while len(samples) > 2 and samples[0].seconds < sample.seconds - window[1]:
        samples.popleft()


def _rate(samples: deque[_Sample], window: tuple[float, float]) -> float:
    """Return the frames read a second between the first and the last sample; 0 if they are too close."""
    if not samples or (seconds := samples[-1].seconds - samples[0].seconds) < window[0]:
        return 0.0
    return (samples[-1].read - samples[0].read) / seconds
