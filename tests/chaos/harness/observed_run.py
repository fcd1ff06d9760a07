"""Run the command as its user does, in a process of its own, and observe all processes that it starts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

import pyarrow.parquet as pq

from benchmark.through_ray.process_costs import Process, process_tree
from chaos.harness.injection import Injector
from mlbs_actors.record.commits import read_commits
from mlbs_actors.source import GapStatus

__all__ = ["ExpectationError", "ObservedRun", "content", "expect", "labelled", "still_running"]

#: Time limit of a run, s.
_RUN_SECONDS = 400.0

#: How long processes may outlive the end of a run, and a kill of its driver, s.
_CLEAN_SECONDS, _CLEAN_SECONDS_AFTER_KILL = 10.0, 90.0


class ExpectationError(Exception):
    """Something that must hold of a run does not; the message says what."""


def expect(holds: bool, otherwise: str) -> None:
    """Raise ExpectationError if a condition does not hold."""
    if not holds:
        raise ExpectationError(otherwise)


def content(stream: Path, *, committed: bool = False) -> dict[str, Any]:
    """Read and check what of a stream's record must not depend on faults: masks, and rows without times.

    Parameters
    ----------
    stream : Path
    committed : bool
        Only what is committed for good: of a stream that is being written, or was interrupted.

    Raises
    ------
    ExpectationError
        If a frame is there twice, missing or out of order, or does not count.
    """
    commits = [commit for commit in read_commits(stream) if not (committed and commit.provisional)]
    counted = commits[-1].last + 1 if commits else 0
    most = counted if committed else None
    rows, layers = _rows(stream, "frames", most), _rows(stream, "layers", most)
    frames = [row["frame"] for row in rows]
    expect(frames == list(range(counted)), f"{stream.name}: the rows are not the {counted} committed frames")
    masks = {path.name: path.read_bytes() for path in sorted((stream / "masks").glob("*.png"))}
    names = {f"{row['name']}.png" for row in labelled(rows)}
    if committed:
        masks = {name: mask for name, mask in masks.items() if name in names}
    expect(masks.keys() == names, f"{stream.name}: {len(masks)} masks for {len(names)} labelled frames")
    frame_rows = [{key: row[key] for key in row if not key.startswith("ms_")} for row in rows]
    return {"masks": masks, "layers": layers, "frames": frame_rows}


def labelled(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Select the frames that have a label map, their own or that of the picture before."""
    return [row for row in rows if row["status"] not in get_args(GapStatus)]


def _rows(stream: Path, table: str, most: int | None) -> list[dict[str, Any]]:
    """Read a table's rows, without the parts that begin after the first ``most`` frames."""
    parts = sorted(stream.glob(f"{table}-*.parquet"))
    counted = [part for part in parts if most is None or int(part.stem.rpartition("-")[2]) < most]
    return [row for part in counted for row in pq.read_table(part).to_pylist()]


class ObservedRun:
    """A run of ``python -m orchestrator``; the end of the ``with`` block ends it and all that it started.

    Parameters
    ----------
    lines : sequence of str
        Of the list of streams.
    folder : Path
        Holds the list and the output.
    flags : str
    injector : Injector, optional
        Of faults into its processes.
    settings : mapping of str to str, optional
        More of its environment.
    """

    def __init__(
        self,
        lines: Sequence[str],
        folder: Path,
        *flags: str,
        injector: Injector | None = None,
        settings: Mapping[str, str] | None = None,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.output = folder / "out"
        self.lines = tuple(lines)
        (folder / "list.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        self._seen: dict[int, Process] = {}
        self._stderr: str | None = None  # None until the command has ended
        self._earlier_status = self._status_text()  # of the run that this one resumes
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "orchestrator", "--streams", str(folder / "list.txt")),
                *("--output", str(self.output), "--save", "masks,parquet", *flags),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=(os.environ if injector is None else injector.environment()) | dict(settings or {}),
        )
        if injector is not None:
            injector.set_driver(self._process.pid)

    def __enter__(self) -> ObservedRun:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.tree()
        if self._process.poll() is None:
            self._process.kill()
        self._wait_for_stderr()
        for pid in self._remaining():
            _signal(pid, signal.SIGKILL)

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the streams of ``status.json``, none before this run has written it."""
        text = self._status_text()
        streams: dict[str, dict[str, Any]] = (
            {} if text == self._earlier_status else json.loads(text)["streams"]
        )
        return streams

    def _status_text(self) -> str:
        try:
            return (self.output / "status.json").read_text(encoding="utf-8")
        except FileNotFoundError:
            return ""

    @property
    def pid(self) -> int:
        """Return the process id of the command."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Return whether the command has ended."""
        return self._process.poll() is not None

    def tree(self) -> dict[int, Process]:
        """Return all living processes of the run."""
        tree = process_tree(self._process.pid)
        self._seen |= {pid: one for pid, one in tree.items() if pid != self._process.pid}
        return tree

    def processes(self, title: str) -> list[int]:
        """Return the ids of the run's living processes with this prefix of their title, sorted."""
        return sorted(pid for pid, one in self.tree().items() if one.title.startswith(title))

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = _RUN_SECONDS) -> None:
        """Wait for a condition; raise ExpectationError if the run ends, or time runs out, before it holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            expect(time.monotonic() < deadline, f"{what}: did not happen within {seconds:.0f} s")
            if self.ended:
                raise ExpectationError(f"{what}: the run had ended before, {self._describe_end()}")
            time.sleep(0.02)

    def wait_for_frames(self, stream: str, frames: int) -> None:
        """Wait until a stream has read so many frames."""

        def there() -> bool:
            return bool(self.status().get(stream, {}).get("read", 0) >= frames)

        self.wait(there, f"frame {frames} of {stream}")

    def signal_driver(self, number: signal.Signals) -> None:
        """Send a signal to the command itself."""
        self.tree()
        self._process.send_signal(number)

    def signal_actor(self, title: str, number: signal.Signals, choice: int = 0) -> None:
        """Wait for a process of the run with this prefix of its title, and send it a signal."""
        found: list[int] = []

        def there() -> bool:
            found[:] = self.processes(title)
            return bool(found)

        self.wait(there, f"a process {title}")
        self.signal_process(found[choice % len(found)], number)

    def signal_process(self, pid: int, number: signal.Signals) -> None:
        """Send a signal to one of :meth:`processes`."""
        _signal(pid, number)

    def end(self, *, killed: bool = False) -> tuple[int, str]:
        """Wait for the end of the run and of all its processes; return its exit status and standard error."""
        self.tree()
        try:
            stderr = self._wait_for_stderr(_RUN_SECONDS)
        except subprocess.TimeoutExpired:
            raise ExpectationError(f"the run did not end within {_RUN_SECONDS:.0f} s") from None
        if not killed:
            self.expect_clean(_CLEAN_SECONDS)
        return self._process.returncode, stderr

    def _wait_for_stderr(self, seconds: float | None = None) -> str:
        """Wait for the end of the command, and return its standard error."""
        if self._stderr is None:
            self._stderr = self._process.communicate(timeout=seconds)[1]
        return self._stderr

    def _describe_end(self) -> str:
        stderr = self._wait_for_stderr()
        return f"with status {self._process.returncode}: {stderr}"

    def expect_clean(self, seconds: float = _CLEAN_SECONDS_AFTER_KILL) -> None:
        """Wait until no process of the run is left."""
        deadline = time.monotonic() + seconds
        while self._remaining():
            expect(time.monotonic() < deadline, f"processes left after {seconds:.0f} s: {self._remaining()}")
            time.sleep(0.1)

    def scratch_is_gone(self) -> bool:
        """Return whether nothing is left of the files of this run's Ray."""
        return not [*Path("/tmp").glob(f"mlbs-ray-{self._process.pid}-*")]

    def _remaining(self) -> dict[int, str]:
        """Return ids and titles of the run's processes that are still alive."""
        return still_running(self._seen, process_tree(1))


def still_running(seen: Mapping[int, Process], living: Mapping[int, Process]) -> dict[int, str]:
    """Return ids and titles of the processes seen before that still run; ids may have been reused.

    A process that has ended and is not collected by its parent has no title any more.
    """
    return {
        pid: living[pid].title
        for pid, one in seen.items()
        if pid in living and living[pid].started == one.started and living[pid].title
    }


def _signal(pid: int, number: signal.Signals) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return
