"""The numbers of frames of files that wait for their turn, for the time that a run has left.

They are found in a process of their own, because a damaged video can abort the one that opens it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from mlbs_actors.actors.stream.protocol import SourceFrame
from mlbs_actors.errors import MlbsError
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["finding_lengths"]

#: How long the rest may take when the lengths are wanted, s.
_PATIENCE_SECONDS = 1.0


@contextmanager
def finding_lengths(
    files: Mapping[str, SourceAddress], folder: Path
) -> Iterator[Callable[[], dict[str, int]]]:
    """Find the lengths of files while the ``with`` block runs.

    Parameters
    ----------
    files : mapping of str to SourceAddress
        By the names of their streams; without cameras.
    folder : Path
        For a temporary file.

    Yields
    ------
    callable
        Returns the lengths that are known, frames by name, and ends the search.
    """
    if not files:
        yield dict
        return
    asked, found = folder / "lengths-asked", folder / "lengths"
    asked.write_text("".join(json.dumps([name, one.location]) + "\n" for name, one in files.items()))
    with (
        asked.open() as questions,
        found.open("w") as answers,
        subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=questions, stdout=answers, stderr=subprocess.DEVNULL
        ) as process,
    ):

        def lengths() -> dict[str, int]:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE_SECONDS)
            process.kill()
            complete = found.read_text().splitlines(keepends=True)
            return dict(json.loads(line) for line in complete if line.endswith("\n"))

        try:
            yield lengths
        finally:
            process.kill()


def _answer() -> None:
    """Write the length of every source that standard input names, as far as it is stated."""
    os.nice(19)
    for line in sys.stdin:
        name, location = json.loads(line)
        with suppress(MlbsError):
            reader = open_reader(parse_address(location, Path()))
            frame = reader.read()
            if isinstance(frame, SourceFrame) and frame.length is not None:
                print(json.dumps([name, frame.length]), flush=True)
            reader.close()


if __name__ == "__main__":
    _answer()
