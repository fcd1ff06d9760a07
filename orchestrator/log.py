"""What a run tells its user: messages on standard error, progress on standard output; text or JSON lines."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
from typing import Any, Literal, TextIO

from orchestrator.credentials import mask

__all__ = ["FORMATS", "Level", "Log", "LogFormat", "ending_quietly"]

LogFormat = Literal["text", "json"]
Level = Literal["info", "warning", "error"]

#: The values of ``--log``.
FORMATS: tuple[LogFormat, ...] = ("text", "json")

#: Exit status of a command whose reader has gone, as a shell shows that of a program that SIGPIPE ended.
_READER_GONE = 128 + signal.SIGPIPE


def _exit(number: int) -> None:
    raise SystemExit(128 + number)


def _now() -> datetime:
    return datetime.now(timezone.utc)


class Log:
    """Writes lines, and asks for the end of the run when nobody reads them any more.

    Parameters
    ----------
    form : LogFormat
    run : str
        Folder of the record, for JSON lines.
    now : callable
        The time, with its zone.

    Attributes
    ----------
    form : LogFormat
    on_reader_gone : callable
        Called with SIGPIPE when an output turns out to be closed, as by ``| head -1``; exits unless a run has
        set it to something that ends it cleanly.
    """

    def __init__(self, form: LogFormat = "text", run: str = "", now: Callable[[], datetime] = _now) -> None:
        self.form = form
        self.on_reader_gone: Callable[[int], None] = _exit
        self._run = run
        self._now = now

    def say(self, text: str, level: Level = "info", stream: str | None = None) -> None:
        """Write a message on standard error: standard output is for progress, which a program may read.

        Parameters
        ----------
        text : str
        level : Level
        stream : str, optional
            The one that it concerns.
        """
        text = mask(text)
        if self.form == "json":
            text = self.json_line("message", level, stream, {"message": text})
        self.write(sys.stderr, text)

    def warn(self, text: str) -> None:
        """Write a message about something that went wrong on standard error."""
        self.say(text, "warning")

    def json_line(self, event: str, level: Level, stream: str | None, figures: Mapping[str, Any]) -> str:
        """Return a JSON object of the documented schema."""
        head = {
            "time": self._now().isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": level,
            "run": self._run,
            "stream": stream,
            "event": event,
        }
        return json.dumps(head | dict(figures))

    def write(self, output: TextIO, line: str) -> None:
        """Write a line to an output."""
        try:
            output.write(line + "\n")
            output.flush()
        except BrokenPipeError:
            _silence(output)
            self.on_reader_gone(signal.SIGPIPE)


@contextmanager
def ending_quietly() -> Iterator[None]:
    """Exit without complaint if standard output or standard error is closed when the ``with`` block ends."""
    try:
        try:
            yield
        finally:
            for output in _outputs():
                output.flush()
    except BrokenPipeError:
        for output in _outputs():
            _silence(output)
        raise SystemExit(_READER_GONE) from None


def _outputs() -> list[TextIO]:
    """Return those that the command was given: a shell can close them, ``>&-``."""
    return [output for output in (sys.stdout, sys.stderr) if output is not None]


def _silence(output: TextIO) -> None:
    """Let what is still written go nowhere; Python itself would complain when it flushes the rest."""
    with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), output.fileno())
