"""Lose one process after the other in one run, and check the streams after each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path

from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import (
    RecoveryTime,
    ScenarioContext,
    Verdicts,
    expect_end,
    expect_identical,
    expect_prefix,
)

__all__ = ["LABELLED", "Loss", "frames_for_losses", "newest_label_map", "run_loss_series", "time_recovery"]

#: Frames until a stream's first snapshot, and its progress between two losses at most.
_FIRST_FRAMES, _FRAMES_OF_A_LOSS = 64, 144

#: Records when a segmenter's process has made its first label map: a stream that was restored has a new one.
LABELLED = Injection("mlbs_actors.actors.stream.segmenter_actor:SegmenterActor.step", "record", when="after")


def frames_for_losses(losses: int) -> int:
    """Return the length of a stream that is still at work after so many losses."""
    return _FIRST_FRAMES + _FRAMES_OF_A_LOSS * losses


Loss = Callable[[ObservedRun, Injector], None]


def run_loss_series(
    context: ScenarioContext,
    verdicts: Verdicts,
    losses: Sequence[tuple[str, Loss]],
    lines: Sequence[str],
    injections: Sequence[Injection] = (),
) -> None:
    """Run streams, and let them lose processes.

    Parameters
    ----------
    context : ScenarioContext
    verdicts : Verdicts
    losses : sequence of str and callable
        Names of faults, and what injects them into a run and returns once they have happened. The first is
        injected when all streams have committed something, each other one when they have committed more than
        at the one before: a stream that makes no progress is restored a few times only.
    lines : sequence of str
        Streams, of :func:`frames_for_losses`.
    injections : sequence of Injection
        To install in the run.
    """
    context.prepare(lines)
    injector = Injector(context.folder / "injector", [LABELLED, *injections])
    with ObservedRun(lines, context.folder, injector=injector) as run:
        reached = {line.split()[0]: 0 for line in lines}
        for name, inject in losses:
            with verdicts.check(name) as verdict:
                _await_progress(run, reached)
                verdict.recovery = _lose(run, injector, inject, reached)
                expect_prefix(context, run, *lines)
        with verdicts.check(losses[-1][0]):  # the next one has shown that each of the others was survived
            expect_end(run, 0)
            expect_identical(context, run, *lines)


def _await_progress(run: ObservedRun, reached: Mapping[str, int]) -> None:
    """Wait until every stream that is still running has committed more label maps than it had reached."""

    def advanced() -> bool:
        status = run.status()
        return bool(status) and all(
            status[name]["committed"] > before or status[name]["state"] == "done"
            for name, before in reached.items()
        )

    run.wait(advanced, "a commit")


def _lose(run: ObservedRun, injector: Injector, inject: Loss, reached: dict[str, int]) -> RecoveryTime:
    """Inject a loss, and wait for the recovery; update how many label maps each stream had reached."""
    returns = {name: stream["returns"] for name, stream in run.status().items()}
    newest = {name: newest_label_map(run.output / name) for name in returns}
    began = time.monotonic()  # not after it: a quick stream may have recovered when that returns
    inject(run, injector)
    reached.update({name: newest_label_map(run.output / name) + 1 for name in returns})

    def hit() -> set[str]:
        return {name for name, stream in run.status().items() if stream["returns"] > returns[name]}

    return time_recovery(run, injector, began, newest, hit)


def time_recovery(
    run: ObservedRun, injector: Injector, began: float, newest: Mapping[str, int], hit: Callable[[], Set[str]]
) -> RecoveryTime:
    """Wait until label maps are made again, and until there is one that did not exist before.

    Parameters
    ----------
    run : ObservedRun
    injector : Injector
        Of the run, with :data:`LABELLED`.
    began : float
        Just before something was lost, monotonic, s: what has recovered by the time of this call counts, too.
    newest : mapping of str to int
        Newest label map of each stream at that time.
    hit : callable
        Returns the names of the streams that went back to a snapshot, as far as they are known yet.
    """

    def labelled() -> list[float]:
        return [moment for moment in injector.recorded_times(LABELLED) if moment > began]

    run.wait(lambda: bool(labelled()), "a label map after the loss")
    first = labelled()[0] - began

    def advanced() -> bool:
        return any(
            newest_label_map(run.output / name) > newest[name] or run.status()[name]["state"] == "done"
            for name in hit()
        )

    run.wait(advanced, "a new label map after the loss")
    return RecoveryTime(first, time.monotonic() - began)


def newest_label_map(stream: Path) -> int:
    """Return the number of the newest label map written, committed or not; −1 for none."""
    names = (path.name.lstrip(".").partition(".")[0] for path in (stream / "masks").glob("*"))
    return max((int(name) for name in names), default=-1)
