"""Shows the progress of a run: a live table on a terminal, lines of text elsewhere, JSON lines on request."""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import Protocol, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from mlbs_actors.wording import count_of
from orchestrator.log import Level, Log
from orchestrator.run.stream_state import ENDED, StreamState, frames_left

__all__ = ["JsonLines", "LiveTable", "PlainLines", "Progress", "progress_for"]

#: Least time between two lines about a stream in the same state, s: for people, and for programs.
_TEXT_SECONDS, _JSON_SECONDS = 30.0, 5.0

#: Least number of streams in the table, and lines reserved for a note.
_LEAST_SHOWN, _NOTE_LINES = 3, 2

#: Window over which the rate of a run is measured, which bridges the starts of its files, s: most and least.
_RATE_SECONDS, _LEAST_RATE_SECONDS = 30.0, 3.0

_STYLES = {"running": "green", "done": "dim", "partial": "yellow", "failed": "red", "waiting": "dim"}


class Progress(Protocol):
    """An observer of the driver that displays the states."""

    def update(self, states: Sequence[StreamState]) -> None:
        """Show the states."""

    def close(self) -> None:
        """Show the last states and release the terminal."""


def progress_for(output: TextIO, log: Log) -> Progress:
    """Return the display for ``output``: lines in the log's format, or a table on a terminal of a person."""
    if log.form == "json":
        return JsonLines(output, log)
    return LiveTable(Console(file=output)) if output.isatty() else PlainLines(output, log)


class _Pace:
    """Decides when a line about a stream is due: its state has changed, or it moves and had none for long."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._shown: dict[str, tuple[float, StreamState]] = {}

    def due(self, state: StreamState, now: float) -> str | None:
        """Return ``state`` for a new state, ``progress`` for more of the same, or None if no line is due."""
        last = self._shown.get(state.name)
        if last is None or last[1].state != state.state:
            event = "state"
        elif state != last[1] and now - last[0] >= self._seconds:
            event = "progress"
        else:
            return None
        self._shown[state.name] = now, state
        return event


class JsonLines:
    """A line per stream when its state changes, and every few seconds while it runs.

    Parameters
    ----------
    output : text file
    log : Log
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, output: TextIO, log: Log, clock: Callable[[], float] = time.monotonic) -> None:
        self._output = output
        self._log = log
        self._clock = clock
        self._pace = _Pace(_JSON_SECONDS)

    def update(self, states: Sequence[StreamState]) -> None:
        """Write the lines that are due."""
        now = self._clock()
        for state in states:
            if event := self._pace.due(state, now):
                figures = {"message": _sentence(state), **state.figures()}
                name = figures.pop("name")
                self._log.write(self._output, self._log.json_line(event, _level(state), name, figures))

    def close(self) -> None:
        """Do nothing: no line is pending."""


class PlainLines:
    """A sentence per stream when its state changes, and now and then while it runs; one for all that wait.

    Parameters
    ----------
    output : text file
    log : Log
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, output: TextIO, log: Log, clock: Callable[[], float] = time.monotonic) -> None:
        self._output = output
        self._log = log
        self._clock = clock
        self._pace = _Pace(_TEXT_SECONDS)
        self._throughput = _Throughput(clock)
        self._summed_up = clock()
        self._reasons: set[str] = set()

    def update(self, states: Sequence[StreamState]) -> None:
        """Write the lines that are due."""
        now, total_left = self._clock(), _left(states, self._throughput.after(states))
        for state in states:
            if state.state != "waiting" and self._pace.due(state, now):
                self._write(_sentence(state))
        waiting = _waiting(states)
        if now - self._summed_up >= _TEXT_SECONDS:
            self._summed_up = now
            if len(states) > 1:
                self._write(f"{_totals(states)}{total_left}")
        elif waiting.keys() <= self._reasons:
            return
        self._reasons = set(waiting)
        for reason, count in waiting.items():
            self._write(f"{count_of(count, 'stream')} waiting for {reason}")

    def close(self) -> None:
        """Do nothing: no line is pending."""

    def _write(self, line: str) -> None:
        self._log.write(self._output, line)


def _level(state: StreamState) -> Level:
    if state.state == "failed":
        return "error"
    return "warning" if state.error is not None else "info"


def _sentence(state: StreamState) -> str:
    """Describe a stream in a line."""
    parts = [f"{state.name}: {state.state}"]
    if state.read:
        parts.append(f"{_read(state)} frames" if state.read > 1 or state.length else "1 frame")
    if state.frames_per_second:
        parts.append(f"{state.frames_per_second:.1f} frames/s")
    if state.layers and state.state not in ENDED:
        parts.append(count_of(state.objects, "object"))
    if lost := state.dropped + state.quarantined:
        parts.append(f"{lost} lost")
    if state.seconds_left is not None and state.state not in ENDED:
        parts.append(f"{_time(state.seconds_left)} left")
    note = _note(state)
    return ", ".join(parts) + (f": {note}" if note else "")


class LiveTable:
    """A table that is redrawn in place; running streams come first, then failed, waiting and finished ones.

    Parameters
    ----------
    console : rich.console.Console
    clock : callable
        Monotonic time, s.
    refresh : bool
        Whether a thread draws the table four times a second; else it is drawn with every update.
    """

    def __init__(
        self, console: Console, clock: Callable[[], float] = time.monotonic, *, refresh: bool = True
    ) -> None:
        self._console = console
        self._throughput = _Throughput(clock)
        self._refresh = refresh
        # Messages to the same terminal go above the table, which would overwrite them.
        self._live = Live(
            console=console,
            auto_refresh=refresh,
            refresh_per_second=4,
            redirect_stdout=False,
            redirect_stderr=sys.stderr.isatty(),
        )
        self._live.start()

    def update(self, states: Sequence[StreamState]) -> None:
        """Show the states with the next refresh."""
        self._live.update(self._table(states), refresh=not self._refresh)

    def close(self) -> None:
        """Draw the last states and release the terminal."""
        self._live.stop()

    def _table(self, states: Sequence[StreamState]) -> Group:
        total_left = _left(states, self._throughput.after(states))
        states = sorted(states, key=lambda state: state.rank)
        shown: list[StreamState] = []
        waiting = _waiting(states)
        room = self._console.height - 7 - _NOTE_LINES * len(waiting)
        for state in states:
            room -= 1 + _NOTE_LINES * bool(_note(state))
            if room < 0 and len(shown) >= _LEAST_SHOWN:
                break
            shown.append(state)
        # Notes go below: a terminal of 80 columns has no room for a sentence beside the figures.
        notes = "".join(f"{state.name}: {note}\n" for state in shown if (note := _note(state)))
        notes += "".join(
            f"{count_of(count, 'stream')} waiting for {reason}\n" for reason, count in waiting.items()
        )
        table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
        for heading in ("stream", "state"):
            table.add_column(heading, no_wrap=True)
        for heading in ("read", "committed", "frames/s", "left", "objects", "lost"):
            table.add_column(heading, justify="right", no_wrap=True)
        for state in shown:
            rate = f"{state.frames_per_second:.1f}" if state.frames_per_second else ""
            lost = state.dropped + state.quarantined
            left = state.seconds_left
            table.add_row(
                escape(state.name),
                f"[{_STYLES.get(state.state, 'cyan')}]{state.state}[/]",
                _read(state),
                str(state.committed),
                rate,
                "" if left is None else _time(left),
                str(state.objects) if state.layers else "",
                str(lost) if lost else "",
            )
        return Group(table, Text(notes + _summary(states, len(shown)) + total_left))


class _Throughput:
    """The rate at which all files of a run together are read.

    Parameters
    ----------
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._read: dict[str, int] = {}
        self._samples: deque[tuple[float, int]] = deque()  # time, frames so far

    def after(self, states: Sequence[StreamState]) -> float:
        """Add the states; return frames/s, 0 while it is unknown."""
        now, frames = self._clock(), self._samples[-1][1] if self._samples else 0
        for state in states:
            # What a stream has read at its first report may be of an earlier run.
            if state.length is not None and state.read:
                frames += max(state.read - self._read.get(state.name, state.read), 0)
                self._read[state.name] = state.read
        if self._read:
            self._samples.append((now, frames))
        while len(self._samples) > 2 and self._samples[0][0] < now - _RATE_SECONDS:
            self._samples.popleft()
        if not self._samples or now - self._samples[0][0] < _LEAST_RATE_SECONDS:
            return 0.0
        started, already = self._samples[0]
        return (frames - already) / (now - started)


def _waiting(states: Sequence[StreamState]) -> dict[str, int]:
    """Return what streams wait for, and how many do."""
    return Counter(s.waits_for for s in states if s.state == "waiting" and s.waits_for)


def _note(state: StreamState) -> str:
    if state.state == "waiting":
        return ""  # many have the same reason
    return state.error or (f"waits for {state.waits_for}" if state.waits_for else state.memory_note or "")


def _read(state: StreamState) -> str:
    if state.length is None or state.state in ENDED:
        return str(state.read)
    return f"{state.read} of {state.length}"


def _summary(states: Sequence[StreamState], shown: int) -> str:
    hidden = len(states) - shown
    return f"{_counts(states)}{f' ({hidden} not shown)' if hidden else ''}\n{_work(states)}"


def _totals(states: Sequence[StreamState]) -> str:
    return f"{_counts(states)}; {_work(states)}"


def _counts(states: Sequence[StreamState]) -> str:
    counts = Counter(state.state for state in states)
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _work(states: Sequence[StreamState]) -> str:
    read, committed = sum(state.read for state in states), sum(state.committed for state in states)
    rate = sum(state.frames_per_second for state in states)
    return f"{read} frames read, {committed} committed, {rate:.1f} frames/s"


def _left(states: Sequence[StreamState], rate: float) -> str:
    """Describe the time that several files have left at a rate, frames/s; empty while it is unknown."""
    frames, more = frames_left(states)
    if len(states) < 2 or not (rate and frames):
        return ""
    return f", {'more than ' if more else ''}{_time(frames / rate)} left"


def _time(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
