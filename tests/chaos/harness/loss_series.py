"""Lose one process after the other in one run, and check the streams after each."""

from __future__ import annotations

import time
from collections.abc import Mapping

from chaos.harness.fault_series import FaultSeries, Inject, newest_label_map, time_recovery
from chaos.harness.injection import Injector
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import RecoveryTime, expect_end, expect_identical, expect_prefix

__all__ = ["frames_for_losses", "run_loss_series"]

#: Frames until a stream's first snapshot, and its progress between two losses at most.
_FIRST_FRAMES, _FRAMES_OF_A_LOSS = 64, 144


def frames_for_losses(losses: int) -> int:
    """Return the length of a stream that is still at work after so many losses."""
    return _FIRST_FRAMES + _FRAMES_OF_A_LOSS * losses


def run_loss_series(series: FaultSeries) -> None:
    """Run streams of :func:`frames_for_losses`, and let them lose processes.

    Each fault returns once it has happened. The first is injected when all streams have committed something,
    each other one when they have committed more than at the one before: a stream that makes no progress is
    restored a few times only.
    """
    context, verdicts, lines = series.context, series.verdicts, series.lines
    injector = series.prepare()
    with ObservedRun(lines, context.folder, injector=injector) as run:
        reached = {line.split()[0]: 0 for line in lines}
        for name, inject in series.faults:
            with verdicts.check(name) as verdict:
                _await_progress(run, reached)
                verdict.recovery = _lose(run, injector, inject, reached)
                expect_prefix(context, run, *lines)
        with verdicts.check(series.faults[-1][0]):  # the next one has shown that each other one was survived
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


def _lose(run: ObservedRun, injector: Injector, inject: Inject, reached: dict[str, int]) -> RecoveryTime:
    """Inject a loss, and wait for the recovery; update how many label maps each stream had reached."""
    returns = {name: stream["returns"] for name, stream in run.status().items()}
    newest = {name: newest_label_map(run.output / name) for name in returns}
    began = time.monotonic()  # not after it: a quick stream may have recovered when that returns
    inject(run, injector)
    reached.update({name: newest_label_map(run.output / name) + 1 for name in returns})

    def hit() -> set[str]:
        return {name for name, stream in run.status().items() if stream["returns"] > returns[name]}

    return time_recovery(run, injector, began, newest, hit)
