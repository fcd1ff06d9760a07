"""The report page: the run's own files and its streams' records, rendered by the template."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.edits import EDITS, NO_EDITS, Edits
from mlbs_actors.record.recorded_stream import edits_of
from mlbs_actors.wording import count_of
from orchestrator.counts.count_files import COUNTS_CSV
from orchestrator.counts.stream_counts import CountReader, Heat, recent_hours
from orchestrator.events.event_file import EVENTS
from orchestrator.events.recent import recent_events
from orchestrator.report import charts
from orchestrator.report.count_charts import heat_chart, place_charts
from orchestrator.report.history import LONG_SECONDS, MOST_FRAMES, StreamHistory, frame_ranges, read_history
from orchestrator.report.pictures import StripPicture, overlay_strip
from orchestrator.rows.score_words import SCORE_WORDS, score_word
from orchestrator.sinks.object_files import OBJECTS_CSV
from orchestrator.sinks.object_list import SeenObject
from orchestrator.sinks.overlay import overlays, stream_remarks
from orchestrator.storage.segments import segment_time

__all__ = ["render_report"]

#: Most pictures of all streams together, so that the page of many streams stays small.
_PICTURES = 150
_PICTURES_OF_A_STREAM = 8

#: Most layers with a row of their own; of more, those that were seen longest.
_LAYERS = 40

#: Most streams shown unfolded; of more, only incomplete ones.
_UNFOLDED = 4

_RANGES = 20  # of lost frames
_OVERLAYS = 24  # newest videos with a link each

#: Newest rows of a stream's counts that are drawn: a day of some zones.
_COUNT_ROWS = 24 * 12

#: Most events with a row of their own; of more, the newest.
_EVENTS = 50


@dataclass(frozen=True, slots=True)
class _Stream:
    """One stream as the template shows it; ``status`` holds its keys in ``status.json``."""

    name: str
    source: str
    has_folder: bool
    has_list: bool
    status: dict[str, Any]
    faults: list[str]
    overlays: tuple[str, ...]
    history: StreamHistory | None
    lives: list[SeenObject]
    strip: list[StripPicture]
    lost: list[str]
    left_out: list[str]
    events: list[dict[str, Any]]
    hours: list[dict[str, str]]
    heat: Heat


def render_report(folder: Path) -> str:
    """Render the page of a run, ended or not.

    Parameters
    ----------
    folder : Path
        The run's output folder.

    Raises
    ------
    ConfigError
        If it holds no run.
    """
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        status = json.loads((folder / "status.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ConfigError(
            f"{folder} holds no run that has begun; name the folder given to --output."
        ) from None
    names = list(status["streams"])
    pictures = max(1, min(_PICTURES_OF_A_STREAM, _PICTURES // max(len(names), 1)))
    streams = [
        _stream(folder / name, run["sources"][name], status["streams"][name], pictures) for name in names
    ]
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.globals |= {
        "charts": charts,
        "count_of": count_of,
        "score_word": score_word,
        "score_words": SCORE_WORDS,
        "stage_colours": _stage_colours,
        "long_time": f"{LONG_SECONDS:g} s or longer",
        "objects_csv": OBJECTS_CSV,
        "events_jsonl": EVENTS,
        "counts_csv": COUNTS_CSV,
        "place_charts": place_charts,
        "heat_chart": heat_chart,
        "most_events": _EVENTS,
    }
    return environment.get_template("report.html").render(
        run=run,
        status=status,
        streams=streams,
        whole=sum(stream.status["state"] == "done" for stream in streams),
        seconds=_seconds(run["started"], status["updated"]),
        unfold_all=len(streams) <= _UNFOLDED,
        command=shlex.join(run["command"]),
        parameters=[
            (section, name, value)
            for section, values in run["config"].items()
            for name, value in values.items()
        ],
    )


def _stream(folder: Path, source: str, status: dict[str, Any], pictures: int) -> _Stream:
    faults = [*([status["error"]] if status["error"] else []), *stream_remarks(folder)]
    try:
        edits = edits_of(folder)
    except ConfigError as error:  # the rest of the page is right without them
        edits = NO_EDITS
        faults.append(f"The corrections of ids are left out. {error}")
    history = read_history(folder, edits)
    lives: list[SeenObject] = []
    strip: list[StripPicture] = []
    lost: list[str] = []
    if history is not None:
        longest = sorted(history.lives, key=lambda life: -life.frames)[:_LAYERS]
        lives = sorted(longest, key=lambda life: life.layer)
        lost = [f"{name}: frames {_ranges(frames)}" for name, frames in history.lost if name != "gap"]
        lost += [f"no picture from {start:.1f} s to {end:.1f} s" for start, end in history.gaps[:_RANGES]]
        if len(history.gaps) > _RANGES:
            lost.append(f"{len(history.gaps) - _RANGES} more such gaps")
        if len(history.frames):
            strip = overlay_strip(folder, history, pictures)
    return _Stream(
        name=folder.name,
        source=source,
        has_folder=folder.is_dir(),
        has_list=(folder / OBJECTS_CSV).exists(),
        status=status,
        faults=faults,
        overlays=tuple(str(path.relative_to(folder)) for _, path in overlays(folder)[-_OVERLAYS:]),
        history=history,
        lives=lives,
        strip=strip,
        lost=lost,
        left_out=_left_out(folder) + _corrected(edits),
        events=recent_events(folder, _EVENTS),
        hours=recent_hours(folder, _COUNT_ROWS),
        heat=CountReader(folder.parent).of(folder.name).heat,
    )


def _left_out(folder: Path) -> list[str]:
    """Say which frames of a stream are not on the page, and why."""
    commits = read_commits(folder)
    if not commits or commits[0].segment is None:
        return []
    first, end = commits[0].first, commits[-1].last + 1
    said = []
    if first:
        began = datetime.fromtimestamp(segment_time(commits[0].segment), timezone.utc)
        said.append(f"Frames before {first}, of the time before {began:%Y-%m-%d %H:%M:%S} UTC, were deleted")
    if end - first > MOST_FRAMES:
        said.append(f"Shown are the newest {MOST_FRAMES} frames; {end - MOST_FRAMES - first} more are kept")
    return said


def _corrected(edits: Edits) -> list[str]:
    """Say that ids on the page are not those of the run."""
    if not edits.edits:
        return []
    number = count_of(len(edits.edits), "correction")
    return [
        f"Objects have the ids of {EDITS}, with {number}; masks, overlays, events and {OBJECTS_CSV} have "
        "those of the run"
    ]


def _ranges(frames: tuple[int, ...]) -> str:
    ranges = frame_ranges(frames)
    shown = [str(first) if first == last else f"{first}–{last}" for first, last in ranges[:_RANGES]]
    return ", ".join(shown) + (f" and {len(ranges) - _RANGES} more" if len(ranges) > _RANGES else "")


def _stage_colours(count: int) -> list[str]:
    return [f"hsl({round(360 * number / count)} 60% {(62, 48)[number % 2]}%)" for number in range(count)]


def _seconds(started: str, ended: str) -> float:
    return (datetime.fromisoformat(ended) - datetime.fromisoformat(started)).total_seconds()
