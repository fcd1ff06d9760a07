"""Streams that wait while the program has not taken their results: files are read later, cameras drop frames.

The driver asks each stream for one burst after the other, and takes a long burst for one that hangs. So a
stream that is to wait is not asked; the driver is answered for it, after a moment, that nothing is new.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Timer

from mlbs_actors.actors.stream.protocol import RunningStream, StreamHost, StreamProgress, StreamSpec
from mlbs_actors.source import FrameReader

__all__ = ["PacedHost"]

#: How long a stream that is to wait is not asked, s.
_PAUSE_SECONDS = 0.1


class PacedHost:
    """A host whose streams wait where they are told to.

    Parameters
    ----------
    host : StreamHost
    is_behind : callable
        Takes a stream's name and the number of its committed label maps; returns whether it is to wait.

    Attributes
    ----------
    running : set of str
        The streams that have processes.
    """

    def __init__(self, host: StreamHost, is_behind: Callable[[str, int], bool]) -> None:
        self.running: set[str] = set()
        self._host = host
        self._is_behind = is_behind

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        """See :meth:`StreamHost.start`."""
        earlier = before.stream if isinstance(before, _Paced) else before
        stream = self._host.start(spec, earlier)
        self.running.add(spec.name)
        return _Paced(stream, spec.name, self._is_behind, self.running)

    def repair(self) -> None:
        """See :meth:`StreamHost.repair`."""
        self._host.repair()

    def close(self) -> None:
        """See :meth:`StreamHost.close`."""
        self._host.close()


class _Paced:
    """A running stream that is asked for more only when it is wanted."""

    def __init__(
        self, stream: RunningStream, name: str, is_behind: Callable[[str, int], bool], running: set[str]
    ) -> None:
        self.stream = stream
        self._name = name
        self._is_behind = is_behind
        self._running = running
        self._newest: StreamProgress | None = None

    @property
    def node(self) -> str | None:
        return self.stream.node

    def advance(self) -> Future[StreamProgress]:
        newest = self._newest
        if newest is not None and self._is_behind(self._name, newest.committed):
            pause: Future[StreamProgress] = Future()
            timer = Timer(_PAUSE_SECONDS, pause.set_result, [newest])
            timer.daemon = True
            timer.start()
            return pause
        burst = self.stream.advance()
        burst.add_done_callback(self._note)
        return burst

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        self.stream.reopen(open_reader)

    def configure(self, settings: object) -> None:
        self.stream.configure(settings)

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        try:
            return self.stream.stop(drain=drain, returns=returns)
        finally:
            self._running.discard(self._name)

    def _note(self, burst: Future[StreamProgress]) -> None:
        if burst.exception() is None:
            self._newest = burst.result()
