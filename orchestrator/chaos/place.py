"""What all faults share: the streams they are brought into, and what must hold of a run whatever happened."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.chaos.observed_run import ObservedRun, content, expect

__all__ = [
    "BESIDE",
    "FRAMES",
    "LINES",
    "VICTIM",
    "Fault",
    "Place",
    "expect_end",
    "expect_identical",
    "expect_no_secret",
    "seconds_until_back",
    "states_of",
    "undisturbed",
]

#: Length of the streams that faults are brought into: three commits, and a snapshot before the last.
FRAMES = 48

VICTIM = f"victim 'synthetic:demo?frames={FRAMES}&width=160&height=120'"
BESIDE = f"beside 'synthetic:pan?frames={FRAMES}&width=160&height=120'"
LINES = (VICTIM, BESIDE)

#: Their names.
NAMES = ("victim", "beside")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fault is brought about.

    Attributes
    ----------
    folder : Path
        For the run's files.
    undisturbed : callable
        Gives the content of the undisturbed streams, by name; slow the first time.
    random : numpy Generator
        Of this fault and seed.
    """

    folder: Path
    undisturbed: Callable[[], dict[str, Any]]
    random: np.random.Generator

    @property
    def expected(self) -> dict[str, Any]:
        """Content of the undisturbed streams, by name."""
        return self.undisturbed()


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the list of those that must be survived.

    Attributes
    ----------
    number : str
        In that list.
    name : str
    bring_about : callable
        Raises NotHeldError; returns the seconds until work went on, if that has a meaning.
    """

    number: str
    name: str
    bring_about: Callable[[Place], float | None]


def undisturbed(folder: Path) -> dict[str, Any]:
    """Run the streams with nothing going wrong; return what they must always give."""
    with ObservedRun(LINES, folder) as run:
        expect_end(run, 0)
        return {name: content(run.output / name) for name in NAMES}


def expect_identical(place: Place, run: ObservedRun, *names: str) -> None:
    """Expect of these streams, by default of both, what an undisturbed run gives."""
    for name in names or NAMES:
        expect(content(run.output / name) == place.expected[name], f"{name} is not as without the fault")


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


def seconds_until_back(run: ObservedRun) -> float:
    """Wait until whichever stream has just lost something is at work again, and tell how long that took."""
    started = time.monotonic()
    run.wait(lambda: any(run.status()[name]["returns"] for name in NAMES), "the loss noticed")
    hit = next(name for name in NAMES if run.status()[name]["returns"])
    run.wait(lambda: run.status()[hit]["state"] in ("running", "done"), f"{hit} back at work")
    return time.monotonic() - started


def states_of(run: ObservedRun) -> set[str]:
    """States of the streams; "none" before they are told."""
    return {stream["state"] for stream in run.status().values()} or {"none"}
