"""What all faults share: the streams they are brought into, and what must hold of a run whatever happened."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chaos.harness.observed_run import NotHeldError, ObservedRun, content, expect
from chaos.harness.reference import References

__all__ = [
    "BESIDE",
    "FRAMES",
    "LINES",
    "VICTIM",
    "Back",
    "Fault",
    "Place",
    "Scenario",
    "Verdict",
    "Verdicts",
    "alone",
    "beginning",
    "beside",
    "expect_end",
    "expect_identical",
    "expect_no_secret",
    "expect_prefix",
    "victim",
]


def victim(frames: int) -> str:
    """Line of the list: the stream that faults are brought into."""
    return f"victim 'synthetic:demo?frames={frames}&width=160&height=120'"


def beside(frames: int) -> str:
    """Line of the list: the stream that must not notice."""
    return f"beside 'synthetic:pan?frames={frames}&width=160&height=120'"


#: Length of the streams where one fault is brought about: three commits, and a snapshot before the last.
FRAMES = 48

VICTIM, BESIDE = victim(FRAMES), beside(FRAMES)
LINES = (VICTIM, BESIDE)


@dataclass(frozen=True, slots=True)
class Back:
    """How long it took until work went on.

    Attributes
    ----------
    first : float
        Until the first label map, those included that are made a second time, s.
    new : float, optional
        Until the first one that was not there before, s.
    """

    first: float
    new: float | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Where faults are brought about.

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
        """Content of the undisturbed stream of a list's line."""
        return self.references.of(line, self.folder)

    def prepare(self, lines: Iterable[str]) -> None:
        """Label undisturbed streams now, because it takes a while, and a run goes on meanwhile."""
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
    """What became of a fault.

    Attributes
    ----------
    problem : str or None
        Why it was not held.
    back : Back or None
        None where it has no meaning.
    """

    problem: str | None = None
    back: Back | None = None
    _looked_at: bool = False

    def add(self, problem: str | None) -> None:
        """Take what one more look has shown; the first problem is kept."""
        self.problem = self.problem or problem
        self._looked_at = True

    @property
    def why_not_held(self) -> str | None:
        """A sentence, None if it was held."""
        return self.problem if self._looked_at else "it was not brought about"


class Verdicts:
    """What becomes of the faults of a scenario, as far as anybody wants to know it.

    Parameters
    ----------
    wanted : iterable of str
        Names of faults.
    tell : callable
        Told the name of a fault and its verdict after each look at it: a scenario takes minutes.
    """

    def __init__(self, wanted: Iterable[str], tell: Callable[[str, Verdict], None]) -> None:
        self.by_name = {name: Verdict() for name in wanted}
        self._tell = tell

    def __contains__(self, name: str) -> bool:
        return name in self.by_name

    @contextmanager
    def of(self, name: str) -> Iterator[Verdict]:
        """Bring a fault about, or look at what it has done; the first thing that does not hold is kept."""
        verdict = self.by_name.setdefault(name, Verdict())
        try:
            yield verdict
        except NotHeldError as error:
            verdict.add(str(error))
        except Exception as error:  # such as a missing file; the rest of the table is wanted all the same
            verdict.add(f"{type(error).__name__}: {error}")
        else:
            verdict.add(None)
        self._tell(name, verdict)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Faults that are brought about together, in one run or in some that follow each other.

    Attributes
    ----------
    name : str
    faults : tuple of Fault
    bring_about : callable
        Tells the verdicts, of those at least that are wanted.
    """

    name: str
    faults: tuple[Fault, ...]
    bring_about: Callable[[Place, Verdicts], None]


def alone(number: str, name: str, bring_about: Callable[[Place], Back | None]) -> Scenario:
    """Make a scenario of one fault; ``bring_about`` raises NotHeldError."""

    def tell(place: Place, verdicts: Verdicts) -> None:
        with verdicts.of(name) as verdict:
            verdict.back = bring_about(place)

    return Scenario(name, (Fault(number, name),), tell)


def expect_identical(place: Place, run: ObservedRun, *lines: str) -> None:
    """Expect of these streams, by default of both, what an undisturbed run gives."""
    for line in lines or LINES:
        name = line.split()[0]
        expect(content(run.output / name) == place.expected(line), f"{name} is not as without the fault")


def expect_prefix(place: Place, run: ObservedRun, *lines: str) -> None:
    """Expect that what these streams, by default both, have committed is that of an undisturbed run."""
    for line in lines or LINES:
        name = line.split()[0]
        committed = content(run.output / name, committed=True)
        expect(
            committed == beginning(place.expected(line), len(committed["frames"])),
            f"{name}: what was committed is not as without the fault",
        )


def beginning(whole: dict[str, Any], frames: int) -> dict[str, Any]:
    """The first frames of a content."""
    rows = whole["frames"][:frames]
    names = {f"{row['name']}.png" for row in rows if row["status"] == "ok"}
    return {
        "masks": {name: mask for name, mask in whole["masks"].items() if name in names},
        "layers": [row for row in whole["layers"] if row["frame"] < frames],
        "frames": rows,
    }


def expect_end(run: ObservedRun, status: int) -> str:
    """Wait for the end of a run and of its processes; expect its exit status and a true ``status.json``.

    Returns what it said on standard error.
    """
    ended, words = run.end()
    expect(ended == status, f"exit status {ended} instead of {status}: {words}")
    expect("Traceback" not in words, f"a traceback: {words}")
    if status != 2:
        expect(run.scratch_is_gone(), "the folder of Ray's files is left")
        _expect_true_status(run.output / "status.json", status)
    return words


def _expect_true_status(path: Path, status: int) -> None:
    told = json.loads(path.read_text(encoding="utf-8"))
    expect((told["ended"], told["exit_status"]) == (True, status), "status.json does not tell the end")
    for name, stream in told["streams"].items():
        counted = stream["committed"] + stream["dropped"] + stream["quarantined"]
        whole = stream["state"] in ("done", "partial") and not stream["interrupted"]
        expect(not whole or stream["read"] == counted, f"{name}: the counts are not those of what was read")


def expect_no_secret(run: ObservedRun, words: str, secret: str) -> None:
    """Expect that no file of the run, and nothing that it said, holds a secret."""
    expect(secret not in words, "a password is told")
    for path in run.output.rglob("*"):
        expect(
            not path.is_file() or secret.encode() not in path.read_bytes(), f"a password is in {path.name}"
        )
