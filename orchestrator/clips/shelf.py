"""The clips of a run on its disk, of which the oldest go."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from orchestrator.events.file_names import CLIPS, in_order
from orchestrator.storage.durable_files import remove_temporary

__all__ = ["ClipShelf"]

#: Share of the bytes from which on the oldest clips may have been deleted.
_FULL = 0.9


@dataclass(frozen=True, slots=True)
class _Clip:
    """One clip under all its names."""

    made: float
    size: int
    paths: tuple[Path, ...]


class ClipShelf:
    """The clips of a run.

    Parameters
    ----------
    folder : Path
        Of the run.
    most : int
        Of each stream.
    most_bytes : int
        Of all together.
    """

    def __init__(self, folder: Path, most: int, most_bytes: int) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._clips: defaultdict[Path, deque[_Clip]] = defaultdict(deque)  # by stream, the oldest one first
        self._size = 0
        found: dict[tuple[int, int], list[Path]] = {}
        for clips in folder.glob(f"*/{CLIPS}"):
            with suppress(OSError):  # what is wrong in one folder holds no other stream up
                remove_temporary(clips)
                for path in clips.glob("*.mp4"):
                    stat = path.stat()
                    found.setdefault((stat.st_dev, stat.st_ino), []).append(path)
        for one in sorted(map(_clip, found.values()), key=lambda clip: clip.made):
            self._add(one)
        self._limit()

    def add(self, paths: Sequence[Path]) -> None:
        """Add a clip that was made under these names; delete the oldest ones if there are too many."""
        with suppress(OSError):  # --keep has deleted it
            self._add(_clip(paths))
        self._limit()

    def takes(self, path: Path) -> bool:
        """Whether a clip stays if it is made; not if it is older than those that had to stay."""
        clips = self._clips[path.parent]
        is_full = len(clips) >= self._most or self._size > _FULL * self._most_bytes
        if not is_full or not clips:
            return True
        return in_order(path.name) >= min(in_order(one.name) for one in clips[0].paths)

    def _add(self, clip: _Clip) -> None:
        self._clips[clip.paths[0].parent].append(clip)
        self._size += clip.size

    def _limit(self) -> None:
        for clips in self._clips.values():
            while len(clips) > self._most:
                self._delete_first(clips)
        while self._size > self._most_bytes:
            full = [clips for clips in self._clips.values() if clips]
            self._delete_first(min(full, key=lambda clips: clips[0].made))

    def _delete_first(self, clips: deque[_Clip]) -> None:
        oldest = clips.popleft()
        self._size -= oldest.size
        for path in oldest.paths:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def _clip(paths: Sequence[Path]) -> _Clip:
    stat = paths[0].stat()
    return _Clip(stat.st_mtime, stat.st_size, tuple(paths))
