"""Scenarios, their faults and verdicts; the streams they disturb, and what must hold of every run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chaos.harness.observed_run import ExpectationError, ObservedRun, content, expect, labelled
from chaos.harness.reference import References
from mlbs_actors.record.record_tables import read_rows
from orchestrator.sinks.object_files import OBJECTS_CSV
from orchestrator.sinks.object_list import ObjectList

__all__ = [
    "BYSTANDER",
    "FRAMES",
    "LINES",
    "VICTIM",
    "Fault",
    "RecoveryTime",
    "Scenario",
    "ScenarioContext",
    "Verdict",
    "Verdicts",
    "bystander",
    "expect_end",
    "expect_identical",
    "expect_no_secret",
    "expect_prefix",
    "first_frames",
    "single_fault",
    "victim",
]


def victim(frames: int) -> str:
    """Return the line of the list for the stream that faults are injected into."""
    return f"victim 'synthetic:demo?frames={frames}&width=160&height=120'"


def bystander(frames: int) -> str:
    """Return the line of the list for the stream that must not be affected."""
    return f"bystander 'synthetic:pan?frames={frames}&width=160&height=120'"


#: Length of the streams where one fault is injected: three commits, and a snapshot before the last.
FRAMES = 48

VICTIM, BYSTANDER = victim(FRAMES), bystander(FRAMES)
LINES = (VICTIM, BYSTANDER)


@dataclass(frozen=True, slots=True)
class RecoveryTime:
    """How long it took to recover.

    Attributes
    ----------
    first : float
        Until the first label map, also one that is made a second time, s.
    new : float, optional
        Until the first one that did not exist before, s.
    """

    first: float
    new: float | None = None


@dataclass(frozen=True, slots=True)
class ScenarioContext:
    """What a scenario is given.

    Attributes
    ----------
    folder : Path
        For the run's files.
    references : References
    random : numpy Generator
        Of this scenario and seed.
    """

    folder: Path
    references: References
    random: np.random.Generator

    def expected(self, line: str) -> dict[str, Any]:
        """Return the content of the undisturbed stream of a list's line."""
        return self.references.of(line, self.folder)

    def prepare(self, lines: Iterable[str]) -> None:
        """Label undisturbed streams now, because it takes a while, and a run would advance meanwhile."""
        for line in lines:
            self.expected(line)


@dataclass(frozen=True, slots=True)
class Fault:
    """A row of the table.

    Attributes
    ----------
    number : str
        In the list of the faults that must be survived; several where one source has several of them.
    name : str
    """

    number: str
    name: str


@dataclass(slots=True)
class Verdict:
    """Whether a fault was survived, and how fast.

    Attributes
    ----------
    problem : str or None
        Why it was not survived.
    recovery : RecoveryTime or None
        None where it has no meaning.
    """

    problem: str | None = None
    recovery: RecoveryTime | None = None
    _checked: bool = False

    def add(self, problem: str | None) -> None:
        """Add the outcome of one more check; the first problem is kept."""
        self.problem = self.problem or problem
        self._checked = True

    @property
    def failure(self) -> str | None:
        """Return why the fault was not survived, None if it was."""
        return self.problem if self._checked else "it was not brought about"


class Verdicts:
    """Verdicts on the chosen faults of a scenario.

    Parameters
    ----------
    wanted : iterable of str
        Names of faults.
    report : callable
        Called with the name of a fault and its verdict after each check: a scenario takes minutes.
    """

    def __init__(self, wanted: Iterable[str], report: Callable[[str, Verdict], None]) -> None:
        self.by_name = {name: Verdict() for name in wanted}
        self._report = report

    def __contains__(self, name: str) -> bool:
        return name in self.by_name

    @contextmanager
    def check(self, name: str) -> Iterator[Verdict]:
        """Judge a fault by what the ``with`` block raises; the first problem is kept."""
        verdict = self.by_name.setdefault(name, Verdict())
        try:
            yield verdict
        except ExpectationError as error:
            verdict.add(str(error))
        except Exception as error:  # such as a missing file; the rest of the table is still useful
            verdict.add(f"{type(error).__name__}: {error}")
        else:
            verdict.add(None)
        self._report(name, verdict)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Faults that are injected together, in one run or in some that follow each other.

    Attributes
    ----------
    name : str
    faults : tuple of Fault
    run : callable
        Injects the faults that the verdicts contain, and adds to these.
    """

    name: str
    faults: tuple[Fault, ...]
    run: Callable[[ScenarioContext, Verdicts], None]


def single_fault(
    number: str, name: str, inject: Callable[[ScenarioContext], RecoveryTime | None]
) -> Scenario:
    """Make a scenario of one fault; ``inject`` raises ExpectationError."""

    def run(context: ScenarioContext, verdicts: Verdicts) -> None:
        with verdicts.check(name) as verdict:
            verdict.recovery = inject(context)

    return Scenario(name, (Fault(number, name),), run)


def expect_identical(context: ScenarioContext, run: ObservedRun, *lines: str) -> None:
    """Expect that these streams, by default both, are those of an undisturbed run."""
    for line in lines or LINES:
        name = line.split()[0]
        stream = run.output / name
        expect(content(stream) == context.expected(line), f"{name} is not as without the fault")
        objects = ObjectList().add(read_rows(stream)).csv(complete=True)
        listed = (stream / OBJECTS_CSV).read_text(encoding="utf-8")
        expect(listed == objects, f"{name}: {OBJECTS_CSV} is not what the tables say")


def expect_prefix(context: ScenarioContext, run: ObservedRun, *lines: str) -> None:
    """Expect that what these streams, by default both, have committed is that of an undisturbed run."""
    for line in lines or LINES:
        name = line.split()[0]
        committed = content(run.output / name, committed=True)
        expect(
            committed == first_frames(context.expected(line), len(committed["frames"])),
            f"{name}: what was committed is not as without the fault",
        )


def first_frames(whole: dict[str, Any], frames: int) -> dict[str, Any]:
    """Return the first frames of a content."""
    rows = whole["frames"][:frames]
    names = {f"{row['name']}.png" for row in labelled(rows)}
    return {
        "masks": {name: mask for name, mask in whole["masks"].items() if name in names},
        "layers": [row for row in whole["layers"] if row["frame"] < frames],
        "frames": rows,
    }


def expect_end(run: ObservedRun, status: int) -> str:
    """Wait for the end of a run; expect its exit status and a true ``status.json``; return its stderr."""
    ended, stderr = run.end()
    expect(ended == status, f"exit status {ended} instead of {status}: {stderr}")
    expect("Traceback" not in stderr, f"a traceback: {stderr}")
    if status != 2:
        expect(run.scratch_is_gone(), "the folder of Ray's files is left")
        _expect_true_status(run.output / "status.json", status)
    return stderr


def _expect_true_status(path: Path, status: int) -> None:
    reported = json.loads(path.read_text(encoding="utf-8"))
    expect(
        (reported["ended"], reported["exit_status"]) == (True, status), "status.json does not show the end"
    )
    for name, stream in reported["streams"].items():
        counted = stream["committed"] + stream["dropped"] + stream["quarantined"]
        whole = stream["state"] in ("done", "partial") and not stream["interrupted"]
        expect(not whole or stream["read"] == counted, f"{name}: the counts are not those of what was read")


def expect_no_secret(run: ObservedRun, stderr: str, secret: str) -> None:
    """Expect a secret neither in a file of the run nor in what it printed."""
    expect(secret not in stderr, "a password is printed")
    for path in run.output.rglob("*"):
        expect(
            not path.is_file() or secret.encode() not in path.read_bytes(), f"a password is in {path.name}"
        )
