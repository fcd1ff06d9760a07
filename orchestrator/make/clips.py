"""The parts of a video in which something moves, joined or apart, and a table of when they were."""

from __future__ import annotations

import csv
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.moments import clock
from orchestrator.make.video_file import VideoFile

__all__ = ["Part", "moving_parts", "write_clips"]

#: What is kept before and after, and what is no pause but one part, s.
_AROUND, _PAUSE = 0.5, 1.0

#: Shorter motion is a glimpse, s.
_SHORTEST = 0.2

_COLUMNS = (
    *("part", "begins", "ends", "begins_s", "ends_s", "first_frame", "last_frame"),
    *("video", "at_s", "objects"),
)


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a stream in which something moves.

    Attributes
    ----------
    first, last : int
        Frames, with some before and after the motion.
    begin, end : float
        Their times, s.
    objects : tuple of int
        Which move, in ascending id.
    """

    first: int
    last: int
    begin: float
    end: float
    objects: tuple[int, ...]


def moving_parts(frames: Iterable[RecordedFrame]) -> list[Part]:
    """Find the parts in which an object moves.

    Parameters
    ----------
    frames : iterable of RecordedFrame
        With the objects that count.
    """
    times: list[tuple[int, float]] = []
    spells: list[tuple[float, float, set[int]]] = []  # begin, end, objects
    for frame in frames:
        times.append((frame.index, frame.pts))
        moving = {one.layer for one in frame.objects if one.state == "moving"}
        if not moving:
            continue
        if spells and frame.pts - spells[-1][1] <= _PAUSE + 2 * _AROUND:
            begin, _, objects = spells[-1]
            spells[-1] = begin, frame.pts, objects | moving
        else:
            spells.append((frame.pts, frame.pts, moving))
    parts = []
    for begin, end, objects in spells:
        if end - begin < _SHORTEST:
            continue
        inside = [one for one in times if begin - _AROUND <= one[1] <= end + _AROUND]
        (first, starts), (last, ends) = inside[0], inside[-1]
        parts.append(Part(first, last, starts, ends, tuple(sorted(objects))))
    return parts


def write_clips(
    footage: Footage, path: Path, suffix: str, shown: Callable[[Shot], Array], *, apart: bool
) -> list[str]:
    """Write the parts in which a chosen object moves.

    Parameters
    ----------
    footage : Footage
    path : Path
        The video, beside which is the table; with ``apart`` a folder with a video for each part.
    suffix : str
        Of the videos.
    shown : callable
        Returns what a frame looks like.
    apart : bool

    Returns
    -------
    list of str
        Remarks.

    Raises
    ------
    ConfigError
        If nothing moves, or no picture of it can be read again.
    """
    parts = moving_parts(footage.recorded())
    if not parts:
        raise ConfigError(f"Nothing that was asked for moves in {footage.name!r}.")
    at: dict[int, tuple[str, float]] = {}  # part → its video, and where it begins there, s
    remarks: list[str] = []
    groups = groupby(_numbered(footage, parts, path.name), key=lambda one: one[0])
    if apart:
        path.mkdir()
        for number, shots in groups:
            name = f"{number + 1:03d}{suffix}"
            with VideoFile(path / name, footage.sound) as video:
                _add(video, shots, shown)
            at[number] = name, 0.0
            remarks += video.remarks
    else:
        with VideoFile(path, footage.sound) as video:
            for number, shots in groups:
                at[number] = path.name, video.cut()
                _add(video, shots, shown)
        remarks = video.remarks
    if not at:
        raise ConfigError(
            f"No part in which something moves in {footage.name!r} can be read again from {footage.source}; "
            "put it back to where it was."
        )
    _write_table(path / "clips.csv" if apart else path.with_suffix(".csv"), parts, at)
    return remarks


def _numbered(footage: Footage, parts: Sequence[Part], doing: str) -> Iterator[tuple[int, Shot]]:
    """Yield the frames of the parts, each with the number of its part, from 0."""
    ends = [part.last for part in parts]
    for shot in footage.shots(doing):
        number = bisect_left(ends, shot.frame.index)
        if number == len(parts):
            return
        if shot.frame.index >= parts[number].first:
            yield number, shot


def _add(video: VideoFile, shots: Iterable[tuple[int, Shot]], shown: Callable[[Shot], Array]) -> None:
    for _, shot in shots:
        video.add(shown(shot), shot.frame.pts, shot.frame.pixel_aspect)


def _write_table(path: Path, parts: Sequence[Part], at: Mapping[int, tuple[str, float]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(_COLUMNS)
        for number, (video, begin) in at.items():  # one whose pictures are missing is not there
            part = parts[number]
            times = clock(part.begin), clock(part.end), round(part.begin, 3), round(part.end, 3)
            ids = " ".join(map(str, part.objects))
            table.writerow([number + 1, *times, part.first, part.last, video, round(begin, 3), ids])
