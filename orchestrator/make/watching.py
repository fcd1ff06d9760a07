"""How far something that is made has come: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from typing import TypeVar

from rich.console import Console
from rich.progress import track

from mlbs_actors.wording import count_of

__all__ = ["Watch"]

_SECONDS = 10.0  # between two lines

_Item = TypeVar("_Item")


class Watch:
    """Shows the progress of one thing, which may take several passes over its frames.

    Parameters
    ----------
    say : callable
        Is given the lines, if standard error is no terminal.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._say = say
        self._clock = clock
        self._said = clock()

    def shown(self, items: Iterable[_Item], doing: str, frames: int) -> Iterator[_Item]:
        """Pass one item a frame on, and show how many of all were; ``doing`` names the pass."""
        console = Console(stderr=True)
        if console.is_terminal:
            yield from track(items, doing, frames, console=console, transient=True)
        else:
            yield from self.told(items, doing, frames)

    def told(self, items: Iterable[_Item], doing: str, frames: int) -> Iterator[_Item]:
        """Do the same in lines, one every 10 s, with the time that the rest of this pass will take."""
        begin = self._clock()
        for done, item in enumerate(items):
            now = self._clock()
            if now - self._said >= _SECONDS:
                self._said = now
                seconds = (now - begin) / max(done, 1) * (frames - done)
                left = f", {timedelta(seconds=round(seconds))} left" if done else ""
                self._say(f"{doing}: {done} of {count_of(frames, 'frame')}{left}")
            yield item
