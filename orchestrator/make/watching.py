"""How far something that is made has come: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from typing import TypeVar

from rich.console import Console
from rich.progress import track

from mlbs_actors.wording import count_of

__all__ = ["watched"]

_SECONDS = 10.0  # between two lines

_Item = TypeVar("_Item")


def watched(items: Iterable[_Item], doing: str, frames: int, say: Callable[[str], None]) -> Iterator[_Item]:
    """Pass frames on and show how many of all were.

    Parameters
    ----------
    items : iterable
        One for each frame.
    doing : str
        What is made of them.
    frames : int
    say : callable
        Is given the lines, if standard error is no terminal.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        yield from track(items, doing, frames, console=console, transient=True)
    else:
        yield from told(items, doing, frames, say)


def told(
    items: Iterable[_Item],
    doing: str,
    frames: int,
    say: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[_Item]:
    """Pass frames on; every 10 s say how many of all were, and how long the rest will take."""
    begin = said = clock()
    for done, item in enumerate(items):
        now = clock()
        if done and now - said >= _SECONDS:
            said = now
            left = timedelta(seconds=round((now - begin) / done * (frames - done)))
            say(f"{doing}: {done} of {count_of(frames, 'frame')}, {left} left")
        yield item
