"""Pictures over HTTP: a stream of JPEGs, or one JPEG that is fetched again and again.

JPEGs are found by their own markers: boundaries of parts and their headers, which cameras write in many ways,
do not matter. A body that ends after one picture is that of a camera to be asked again and again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial

from mlbs_actors.errors import SourceError
from orchestrator.sources.http_answer import HttpAnswer, HttpCamera
from orchestrator.sources.images import decode_image
from orchestrator.sources.jpeg import JpegFinder
from orchestrator.sources.live_buffer import Picture
from orchestrator.sources.packets import PacketStore

__all__ = ["JpegConnection"]

#: Shortest and longest time between two requests for the same picture, s.
_POLL_SECONDS, _SLOWEST_POLL_SECONDS = 0.2, 2.0


class JpegConnection:
    """Receives the JPEGs of one address.

    Parameters
    ----------
    camera : HttpCamera
    answer : HttpAnswer
        The camera's first.
    head : bytes
        What has been read of it.
    patience_s : float
        Time without a picture after which the connection is given up, s.
    clock, sleep : callable
        Monotonic time and a pause, s.
    packets : PacketStore, optional
        Keeps the pictures.
    """

    def __init__(
        self,
        camera: HttpCamera,
        answer: HttpAnswer,
        head: bytes,
        *,
        patience_s: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        packets: PacketStore | None = None,
    ) -> None:
        self._keeper = None if packets is None else packets.jpeg_recorder()
        self._camera, self._answer, self._head = camera, answer, head
        self._patience_s = patience_s
        self._clock, self._sleep = clock, sleep

    def pictures(self) -> Iterator[Picture | None]:
        """Yield the pictures as they come, None where the camera answered that there is no newer one."""
        asked, pause = self._clock(), _POLL_SECONDS
        answer: HttpAnswer | None = self._answer
        shown: bytes | None = None
        while True:
            before, count = shown, 0
            for count, shown in enumerate(self._jpegs(), 1) if answer else ():
                if count > 1 or shown != before:
                    if self._keeper is not None:
                        self._keeper.keep(shown)
                    yield Picture(None, partial(decode_image, shown))
            if count > 1:
                return
            if answer and count == 0:
                raise SourceError("its answer holds no whole JPEG")
            if shown == before:
                yield None
            # A picture that seldom changes is asked for less often.
            pause = min(2 * pause, _SLOWEST_POLL_SECONDS) if shown == before else _POLL_SECONDS
            self._sleep(max(0.0, asked + pause - self._clock()))
            asked = self._clock()
            self._answer.close()
            if answer := self._camera.get(self._answer.version):
                self._answer, self._head = answer, b""

    def close(self) -> None:
        """Close the connection."""
        if self._keeper is not None:
            self._keeper.close()
        self._answer.close()

    def _jpegs(self) -> Iterator[bytes]:
        finder, came = JpegFinder(), self._clock()
        data = self._head or self._answer.read()
        while data:
            for jpeg in finder.feed(data):
                came = self._clock()
                yield jpeg
            if self._clock() - came > self._patience_s:
                raise SourceError("it sends no whole JPEG")
            data = self._answer.read()
