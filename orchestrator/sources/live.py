"""Network and local cameras: read at their own pace, reconnected when they go away.

A thread receives the camera's pictures, and :meth:`LiveReader.read` returns them at the pipeline's pace. A
silent or absent camera does not end its stream: ``read`` then reports that, at least once in
:data:`_ANSWER_SECONDS`. It is tried for ever, even if it never sent a picture, unless a limit is given.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial

from mlbs_actors.errors import SourceError
from mlbs_actors.source import SourceFrame, SourceSilence
from orchestrator.retries import LONGEST_RETRY_SECONDS, retry_seconds
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.connection import Connection, connect
from orchestrator.sources.live_buffer import STALL_SECONDS, LiveBuffer, LiveTime, Picture
from orchestrator.sources.packets import PacketStore

__all__ = ["LiveReader"]

#: Longest time until :meth:`LiveReader.read` answers, s.
_ANSWER_SECONDS = 0.5

#: Silence after which a connection is abandoned with its thread, s: a device whose driver hangs ends no call.
_HUNG_SECONDS = 3 * STALL_SECONDS

#: A connection that lasted this long was good, so the next attempt follows soon, s.
_GOOD_SECONDS = 10.0


class LiveReader:
    """Reads a camera.

    Parameters
    ----------
    name : str
        The camera's address without credentials, for messages.
    connect : callable
        Opens a connection; SourceError if the camera cannot be reached.
    give_up_after : float, optional
        Time without a picture after which the camera is given up, s.
    clock : callable
        Monotonic time, s.
    sleep : callable, optional
        Waits for some seconds, or until the reader is closed.

    Attributes
    ----------
    problem : str, optional
        That the camera was given up. Its drops and gaps are rows.
    """

    problem: str | None = None

    def __init__(
        self,
        name: str,
        connect: Callable[[], Connection],
        give_up_after: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self._name = name
        self._connect = connect
        self._give_up_after = give_up_after
        self._clock = clock
        self._closed = threading.Event()
        self._sleep = sleep or self._closed.wait
        self._changed = threading.Condition()
        # The following is shared by the threads and only accessed with the condition held.
        self._buffer = LiveBuffer()
        self._time = LiveTime()
        self._last_picture = self._last_sign = clock()  # a sign of life is a connection or a picture
        self._last_picture_at = datetime.now().astimezone()
        self._delivered = False
        self._connected = False
        self._absence: str | None = None  # why there was no connection since the last picture
        self._failures = 0
        self._newest = 0  # number of the thread that serves the camera
        self._start_thread()

    @classmethod
    def of(
        cls, address: SourceAddress, give_up_after: float | None = None, packets: PacketStore | None = None
    ) -> LiveReader:
        """Read the camera at an address, and keep its packets if so asked."""
        return cls(str(address), partial(connect, address, packets), give_up_after)

    def read(self) -> SourceFrame | SourceSilence | None:
        """Return the next frame, drop or gap, or that there is none at present; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._buffer or self._closed.is_set(), _ANSWER_SECONDS)
            if self._closed.is_set():
                return None
            if not self._buffer:
                return self._silence()
            taken = self._buffer.take()
        return taken()

    def close(self) -> None:
        """Release the camera; its thread ends when its call returns."""
        with self._changed:
            self._closed.set()
            self._newest += 1
            self._changed.notify_all()

    def _silence(self) -> SourceSilence | None:
        now = self._clock()
        silent = now - self._last_sign
        if self._connected and silent > _HUNG_SECONDS:
            self._failures += 1
            self._connected, self._absence = False, f"it was silent for {silent:.0f} s"
            self._start_thread()
        if self._give_up_after is not None and now - self._last_picture > self._give_up_after:
            why = "" if self._absence is None else f": {self._absence}"
            most = f"{self._give_up_after:.0f} s"
            self.problem = f"The camera {self._name} sent no picture for {most} and was given up{why}."
            self.close()
            return None
        # A connection alone does not make it reachable: the state would change with every attempt.
        since = f"since {self._last_picture_at:%Y-%m-%d %H:%M %Z}"
        if self._absence is not None:
            return SourceSilence(
                "reconnecting",
                f"The camera {self._name} has been unreachable {since}: {self._absence}. "
                f"It is tried again at least every {LONGEST_RETRY_SECONDS:.0f} s.",
            )
        if self._connected and silent > STALL_SECONDS:
            return SourceSilence("stalled", f"The camera {self._name} has been silent {since}.")
        return SourceSilence(None)

    def _start_thread(self) -> None:
        """Start a new thread for the camera; a hanging one is ignored from now on."""
        self._newest += 1
        threading.Thread(target=self._keep_connected, args=(self._newest,), daemon=True).start()

    def _keep_connected(self, number: int) -> None:
        """Connect and receive, repeatedly, until another thread takes over or the reader is closed."""
        while self._is_current(number):
            connected = self._clock()
            try:
                connection = self._connect()
                lost = self._receive(number, connection)
            except SourceError as error:
                lost = str(error).removeprefix(f"Cannot open {self._name}: ")
            except Exception as error:
                # Only its type: its text may contain the address, and with it a password.
                lost = f"it failed with {type(error).__name__}"
            with self._changed:
                if number != self._newest:
                    return
                lasted = self._delivered and self._clock() - connected >= _GOOD_SECONDS
                self._failures = 1 if lasted else self._failures + 1
                self._connected, self._absence = False, lost.rstrip(".")
                pause = retry_seconds(self._failures)
            self._sleep(pause)

    def _receive(self, number: int, connection: Connection) -> str:
        """Receive from one connection; return or raise why it ended."""
        with self._changed:
            if number == self._newest:
                self._connected, self._last_sign = True, self._clock()
                self._time.reconnected()
        returned = self._delivered
        try:
            for picture in connection.pictures():
                if not self._take(number, picture, returned):
                    break
                returned = returned and picture is None
        finally:
            connection.close()
        return "it ended the connection"

    def _take(self, number: int, picture: Picture | None, returned: bool) -> bool:
        with self._changed:
            if number != self._newest:
                return False
            now = self._clock()
            if picture is None:
                self._last_sign = now
                return True
            if returned or (self._delivered and now - self._last_sign > STALL_SECONDS):
                self._buffer.gap(self._time.last)
            pts = self._time.of(picture.time, now)
            self._buffer.put(picture, pts, time.time() - self._time.delay)
            self._last_picture = self._last_sign = now
            self._last_picture_at = datetime.now().astimezone()
            self._delivered, self._absence = True, None
            self._changed.notify_all()
            return True

    def _is_current(self, number: int) -> bool:
        with self._changed:
            return number == self._newest
