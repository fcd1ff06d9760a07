"""Network cameras and local ones: read as they send, connected again when they go away.

A thread takes what the camera sends, at the camera's pace, and :meth:`LiveReader.read` hands it on at the
pipeline's. A camera that is silent or away is no end of its stream: ``read`` then says so, at least
once in :data:`_ANSWER_SECONDS`. Only a camera that never gave a picture is given up.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Protocol

import av
import av.error
import av.logging

from mlbs_actors.actors.stream.protocol import SourceFrame, SourceSilence
from mlbs_actors.errors import SourceError
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.libav import open_video, reason, upright_bgr
from orchestrator.sources.live_buffer import STALL_SECONDS, LiveBuffer, LiveTime, Picture, retry_seconds

__all__ = ["Connection", "LibavConnection", "LiveReader"]

#: Longest time until :meth:`LiveReader.read` answers, s.
_ANSWER_SECONDS = 0.5

#: Silence after which libav gives a connection up, s.
_DEAD_SECONDS = 2 * STALL_SECONDS

#: Silence after which a connection is left to its thread, s: a device whose driver hangs ends no call.
_HUNG_SECONDS = 3 * STALL_SECONDS

#: Tries to connect until a camera that never gave a picture is given up.
_FIRST_TRIES = 6

#: A connection that lasted as long was a good one: the next is tried soon, s.
_GOOD_SECONDS = 10.0


class Connection(Protocol):
    """An open connection to a camera."""

    def pictures(self) -> Iterator[Picture]:
        """Give what the camera sends, as it comes; SourceError if the connection is lost."""

    def close(self) -> None:
        """End it."""


class LibavConnection:
    """A connection made by libav.

    Parameters
    ----------
    address : SourceAddress
        Of kind NETWORK or CAMERA.
    clock : callable
        Monotonic time, s.

    Raises
    ------
    SourceError
        If the camera cannot be reached or sends no video; the message hides credentials.
    """

    def __init__(self, address: SourceAddress, clock: Callable[[], float] = time.monotonic) -> None:
        self._container, self._stream, _ = open_video(address, _DEAD_SECONDS)
        self._clock = clock

    def pictures(self) -> Iterator[Picture]:
        """Give what the camera sends; what was damaged on its way is passed over, as players do."""
        with av.logging.Capture():
            try:
                asked = self._clock()
                for packet in self._container.demux(self._stream):
                    # Out of patience, libav gives what it has of the picture under way, and goes on.
                    if self._clock() - asked >= _DEAD_SECONDS:
                        raise SourceError("no answer in time")
                    with suppress(av.error.InvalidDataError):
                        for frame in packet.decode():
                            yield Picture(frame.time, partial(upright_bgr, frame))
                    asked = self._clock()
            except (av.error.FFmpegError, OSError) as error:
                raise SourceError(reason(error)) from None

    def close(self) -> None:
        """End it."""
        self._container.close()


class LiveReader:
    """Reads a camera.

    Parameters
    ----------
    name : str
        The camera's address without credentials, for messages.
    connect : callable
        Makes a connection; SourceError if the camera cannot be reached.
    clock : callable
        Monotonic time, s.
    sleep : callable, optional
        Waits for some seconds, or until the reader is closed.
    """

    #: A camera is cut off by whoever ends the run; its drops and gaps are rows.
    problem: str | None = None

    def __init__(
        self,
        name: str,
        connect: Callable[[], Connection],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self._name = name
        self._connect = connect
        self._clock = clock
        self._closed = threading.Event()
        self._sleep = sleep or self._closed.wait
        self._changed = threading.Condition()
        # What follows is shared by the threads and only touched with the condition held.
        self._buffer = LiveBuffer()
        self._time = LiveTime()
        self._heard = clock()  # when the camera last gave a sign of life
        self._delivered = False
        self._absence: str | None = "it was not connected yet"  # why there is no connection
        self._failures = 0
        self._failure: str | None = None
        self._line = 0  # number of the thread that speaks for the camera
        self._start_line()

    @classmethod
    def of(cls, address: SourceAddress) -> LiveReader:
        """Read the camera at an address."""
        return cls(str(address), partial(LibavConnection, address))

    def read(self) -> SourceFrame | SourceSilence | None:
        """Return the next frame, drop or gap, or that there is none at present; None once closed.

        Raises
        ------
        SourceError
            If the camera never gave a picture and is given up.
        """
        with self._changed:
            self._changed.wait_for(self._has_news, _ANSWER_SECONDS)
            if self._closed.is_set():
                return None
            if not self._buffer:
                if self._failure is not None:
                    raise SourceError(self._failure)
                return self._silence()
            taken = self._buffer.take()
        return taken()

    def close(self) -> None:
        """Let go of the camera; its thread ends with what it is waiting for."""
        with self._changed:
            self._closed.set()
            self._line += 1
            self._changed.notify_all()

    def _has_news(self) -> bool:
        return bool(self._buffer) or self._failure is not None or self._closed.is_set()

    def _silence(self) -> SourceSilence:
        silent = self._clock() - self._heard
        if self._absence is None and silent > _HUNG_SECONDS:
            self._failures += 1
            self._absence = f"it was silent for {silent:.0f} s"
            self._start_line()
        if self._absence is not None and self._failures:
            return SourceSilence("reconnecting", f"The camera {self._name} is away: {self._absence}.")
        if self._absence is None and silent > STALL_SECONDS:
            return SourceSilence("stalled", f"The camera {self._name} has been silent for {silent:.0f} s.")
        return SourceSilence(None)

    def _start_line(self) -> None:
        """Give the camera a new thread; one that hangs is no longer heard."""
        self._line += 1
        threading.Thread(target=self._hold_line, args=(self._line,), daemon=True).start()

    def _hold_line(self, line: int) -> None:
        """Connect, take what comes, and again, until somebody else does or nobody wants it."""
        while self._speaks(line):
            connected = self._clock()
            try:
                connection = self._connect()
                lost = self._listen(line, connection)
            except SourceError as error:
                lost = str(error).removeprefix(f"Cannot open {self._name}: ")
            except Exception as error:
                # Only its type: its text may hold the address, and with it a password.
                lost = f"it failed with {type(error).__name__}"
            with self._changed:
                if line != self._line:
                    return
                lasted = self._delivered and self._clock() - connected >= _GOOD_SECONDS
                self._failures = 1 if lasted else self._failures + 1
                self._absence = lost.rstrip(".")
                if not self._delivered and self._failures >= _FIRST_TRIES:
                    self._failure = (
                        f"The camera {self._name} gave no picture in {_FIRST_TRIES} tries: {self._absence}. "
                        "Check its address, its password and whether it is switched on."
                    )
                    self._changed.notify_all()
                    return
                pause = retry_seconds(self._failures)
            self._sleep(pause)

    def _listen(self, line: int, connection: Connection) -> str:
        """Take what one connection gives; return or raise why it ended."""
        with self._changed:
            if line == self._line:
                self._absence, self._heard = None, self._clock()
                self._time.reconnected()
        returned = self._delivered
        try:
            for picture in connection.pictures():
                if not self._take(line, picture, returned):
                    break
                returned = False
        finally:
            connection.close()
        return "it ended the connection"

    def _take(self, line: int, picture: Picture, returned: bool) -> bool:
        with self._changed:
            if line != self._line:
                return False
            now = self._clock()
            if returned or (self._delivered and now - self._heard > STALL_SECONDS):
                self._buffer.gap(self._time.last)
            self._buffer.put(picture, self._time.of(picture.time, now))
            self._heard, self._delivered = now, True
            self._changed.notify_all()
            return True

    def _speaks(self, line: int) -> bool:
        with self._changed:
            return line == self._line
