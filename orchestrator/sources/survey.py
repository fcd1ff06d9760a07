"""What the files of a run hold: numbers of frames, their size, and which of them are no sources at all.

They are opened in a process of their own, because a damaged video can abort the one that opens it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from mlbs_actors.errors import MlbsError
from mlbs_actors.source import SourceFrame
from orchestrator.module_path import PACKAGE_ROOT
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["SourceContent", "Survey", "surveying"]

#: How long the process may take to its first answer, s.
_START_SECONDS = 60.0

#: How long the rest may take when the survey ends, s.
_PATIENCE_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class SourceContent:
    """What a source holds, as far as its first frame and its header say.

    Attributes
    ----------
    length : int, optional
        Number of frames, if it is stated.
    size : tuple of int, optional
        Height and width of the first frame, px, if it can be decoded.
    fault : str, optional
        Why the source cannot be read at all, a sentence.
    """

    length: int | None = None
    size: tuple[int, int] | None = None
    fault: str | None = None


class Survey:
    """The answers of a process that opens one source after the other.

    Parameters
    ----------
    process : subprocess.Popen, optional
        None if there is nothing to ask.
    answers : Path
        What it writes.
    """

    def __init__(self, process: subprocess.Popen[bytes] | None, answers: Path) -> None:
        self._process = process
        self._answers = answers

    def begin(self, seconds: float) -> dict[str, SourceContent]:
        """Return what is known when all is, or so long after the first answer; the rest has low priority.

        How long the process takes to start says nothing about the sources.
        """
        if self._process is None:
            return {}
        deadline = time.monotonic() + _START_SECONDS
        while not self._answers.stat().st_size and self._process.poll() is None:
            if time.monotonic() > deadline:
                break
            time.sleep(0.02)
        found = self._after(seconds)
        if self._process.poll() is None:
            with suppress(ProcessLookupError):  # it has just ended
                os.setpriority(os.PRIO_PROCESS, self._process.pid, 19)
        return found

    def finish(self) -> dict[str, SourceContent]:
        """Return what is known, and end the survey."""
        found = self._after(_PATIENCE_SECONDS)
        self.close()
        return found

    def close(self) -> None:
        """End the survey."""
        if self._process is not None:
            self._process.kill()

    def _after(self, seconds: float) -> dict[str, SourceContent]:
        if self._process is None:
            return {}
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        lines = self._answers.read_text().splitlines(keepends=True)
        found = [json.loads(line) for line in lines if line.endswith("\n")]
        return {name: _content(fields) for name, fields in found}


@contextmanager
def surveying(files: Mapping[str, SourceAddress], folder: Path) -> Iterator[Survey]:
    """Look into files while the ``with`` block runs.

    Parameters
    ----------
    files : mapping of str to SourceAddress
        By the names of their streams; without cameras.
    folder : Path
        For two temporary files.
    """
    asked, found = folder / "survey-asked", folder / "survey"
    if not files:
        yield Survey(None, found)
        return
    asked.write_text("".join(json.dumps([name, one.location]) + "\n" for name, one in files.items()))
    with (
        asked.open() as questions,
        found.open("w") as answers,
        subprocess.Popen(
            [sys.executable, "-m", __name__],
            cwd=PACKAGE_ROOT,
            stdin=questions,
            stdout=answers,
            stderr=subprocess.DEVNULL,
        ) as process,
    ):
        survey = Survey(process, found)
        try:
            yield survey
        finally:
            survey.close()


def _content(fields: dict[str, object]) -> SourceContent:
    length, size, fault = (fields[name] for name in ("length", "size", "fault"))
    return SourceContent(
        length if isinstance(length, int) else None,
        (size[0], size[1]) if isinstance(size, list) else None,
        fault if isinstance(fault, str) else None,
    )


def _look(location: str) -> SourceContent:
    try:
        reader = open_reader(parse_address(location, Path()))
        frame = reader.read()
        reader.close()
    except MlbsError as error:
        return SourceContent(fault=str(error))
    if not isinstance(frame, SourceFrame):
        return SourceContent()
    image = frame.image
    return SourceContent(frame.length, None if image is None else (image.shape[0], image.shape[1]))


def _answer() -> None:
    """Write what every source holds that standard input names."""
    for line in sys.stdin:
        name, location = json.loads(line)
        print(json.dumps([name, asdict(_look(location))]), flush=True)


if __name__ == "__main__":
    _answer()
