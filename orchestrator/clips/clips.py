"""Sees to it that every event that names a clip gets it: a thread beside the driver.

The files ``events.jsonl`` are the queue, and a clip that is there is done. So a run that is started again
makes what a killed one has left, as far as the packets are still there. Neither the process that reads a
camera nor the one that writes its record waits for a clip.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from orchestrator.clips.cutter import Cutter, CutterLostError
from orchestrator.clips.cutting import CutRequest
from orchestrator.clips.packet_ring import PACKETS
from orchestrator.clips.settings import ClipSettings
from orchestrator.clips.shelf import ClipShelf
from orchestrator.clips.wanted import Cut, WantedClip, next_cut, wanted_clip
from orchestrator.events.event_file import EVENTS
from orchestrator.events.file_names import CLIPS
from orchestrator.storage.durable_files import remove_temporary

__all__ = ["Clips"]

#: Between two looks at the files, s.
_LOOK_SECONDS = 1.0

#: Attempts at a clip at which the process that cuts is lost.
_ATTEMPTS = 3

#: How long the end of a run waits for the clips that are owed, s.
_GRACE_SECONDS = 10.0


@dataclass(slots=True)
class _Stream:
    """A stream's events.

    Attributes
    ----------
    place : int
        Up to which byte its file was read.
    seen : tuple of int
        Size and time of change that it had then.
    last : bytes
        The line that ends there: another one means that the file was replaced.
    wanted : set of WantedClip
        Those that are owed.
    has_fault : bool
        Whether it was said that one cannot be made.
    """

    place: int = 0
    seen: tuple[int, int] = (0, 0)
    last: bytes = b""
    wanted: set[WantedClip] = field(default_factory=set)
    has_fault: bool = False


class Clips:
    """Makes the clips of a run's events from the start to the end of a ``with`` block.

    Parameters
    ----------
    settings : ClipSettings
    folder : Path
        Of the run, which is locked.
    video_of : callable
        Returns the video that a stream reads by its name; None of a camera.
    say : callable
        Receives a sentence when the first clip of a stream cannot be made.
    clock : callable
        Seconds since 1970.
    """

    def __init__(
        self,
        settings: ClipSettings,
        folder: Path,
        video_of: Callable[[str], Path | None],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._settings = settings
        self._folder = folder
        self._video_of = video_of
        self._say = say
        self._clock = clock
        self._cutter = Cutter()
        self._streams: dict[Path, _Stream] = {}
        self._last_look, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="clips", daemon=True)

    def __enter__(self) -> Clips:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        """Make what is owed with the packets that there are, for a limited time, and stop."""
        self._last_look.set()
        self._thread.join(_GRACE_SECONDS)
        self._stop.set()
        self._cutter.close()

    def _run(self) -> None:
        shelf: ClipShelf | None = None
        while not self._stop.is_set():
            last = self._last_look.is_set()
            with suppress(OSError):  # the disk is away: look again
                shelf = shelf or ClipShelf(self._folder, self._settings.most, self._settings.most_bytes)
                for events in sorted(self._folder.glob(f"*/{EVENTS}")):
                    with suppress(OSError, ValueError):  # so is this folder's, or a line was just replaced
                        self._look(events, shelf, last)
            if last:
                return
            self._last_look.wait(_LOOK_SECONDS)

    def _look(self, events: Path, shelf: ClipShelf, last: bool) -> None:
        """Read a stream's new events, and make the clips that are due."""
        folder = events.parent
        stream = self._streams.setdefault(folder, _Stream())
        for event in _new_events(events, stream):
            one = wanted_clip(event, self._settings)
            if one is not None and shelf.takes(folder / one.path) and not (folder / one.path).exists():
                stream.wanted.add(one)
        stream.wanted = set(sorted(stream.wanted)[-self._settings.most :])
        if not stream.wanted:
            return
        video = self._video_of(folder.name)
        now = float("inf") if last or video is not None else self._clock()
        while not self._stop.is_set() and (due := next_cut(list(stream.wanted), now)) is not None:
            if not self._make(folder, due, video, stream):
                return
            paths = [path for path in (folder / name for name in due.paths) if path.exists()]
            if paths:
                shelf.add(paths)
            stream.wanted = {one for one in stream.wanted if one.path not in due.paths}

    def _make(self, folder: Path, due: Cut, video: Path | None, stream: _Stream) -> bool:
        """Make a clip; return whether it is done with, made or not."""
        request = CutRequest(
            due.begin,
            due.end,
            tuple(str(folder / path) for path in due.paths),
            None if video is not None else str(folder / PACKETS),
            None if video is None else str(video),
        )
        fault: str | None = None
        for _ in range(_ATTEMPTS):
            try:
                fault = self._cutter.cut(request)
                break
            except CutterLostError as error:
                if self._stop.is_set():
                    return False
                remove_temporary(folder / CLIPS)
                fault = str(error)
                if error.was_late:
                    break
        if fault and not stream.has_fault:
            stream.has_fault = True
            self._say(f"A clip of {folder.name} cannot be made: {fault.rstrip('.')}.")
        return True


def _new_events(path: Path, stream: _Stream) -> Iterator[dict[str, Any]]:
    """Yield the events behind the place up to which a file was read, or all if it was replaced."""
    stat = path.stat()
    seen = stat.st_size, stat.st_mtime_ns
    if seen == stream.seen:
        return
    with path.open("rb") as file:
        file.seek(stream.place - len(stream.last))
        if file.read(len(stream.last)) != stream.last:
            stream.place, stream.last = 0, b""
            file.seek(0)
        for line in file:
            if not line.endswith(b"\n"):
                return  # it is being written
            stream.place, stream.last = stream.place + len(line), line
            yield json.loads(line)
    stream.seen = seen
