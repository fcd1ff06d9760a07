"""End a run in one way after the other, and resume it with ``--resume`` at once after each."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from contextlib import ExitStack

from chaos.harness.fault_series import FaultSeries, newest_label_map, time_recovery
from chaos.harness.injection import Injector
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import ScenarioContext, expect_end, expect_identical, expect_prefix

__all__ = ["frames_for_ends", "kill", "run_end_series"]

#: Frames until a stream's first snapshot, and its progress between two ends, on average at most: some ends
#: come with the third commit from then on.
_FIRST_FRAMES, _FRAMES_OF_AN_END = 64, 64

#: Largest progress before something is done to the run, frames.
_FRAMES_BEFORE = 16


def frames_for_ends(ends: int) -> int:
    """Return the length of a stream that is still at work after so many ends."""
    return _FIRST_FRAMES + _FRAMES_OF_AN_END * ends


def kill(run: ObservedRun, injector: Injector) -> None:
    """Kill the command."""
    run.signal_driver(signal.SIGKILL)
    run.end(killed=True)


def run_end_series(series: FaultSeries) -> None:
    """Run streams of :func:`frames_for_ends`, end the run, resume it, and so on up to the streams' ends.

    Each fault is injected when all streams have label maps that they did not have before. Where it ended the
    run, the next one resumes it.
    """
    context, verdicts, lines = series.context, series.verdicts, series.lines
    injector = series.prepare()
    names = [line.split()[0] for line in lines]
    with ExitStack() as runs:

        def started(*flags: str) -> ObservedRun:
            return runs.enter_context(ObservedRun(lines, context.folder, *flags, injector=injector))

        def resumed(ended: ObservedRun, name: str) -> ObservedRun:
            newest = {stream: newest_label_map(ended.output / stream) for stream in names}
            began = time.monotonic()
            run = started("--resume")
            with verdicts.check(name) as verdict:
                verdict.recovery = time_recovery(run, injector, began, newest, lambda: newest.keys())
                expect_prefix(context, run, *lines)
            return started("--resume") if run.ended else run  # the next one has a verdict of its own

        run, before = started(), ""
        ended_by: list[tuple[str, ObservedRun]] = []
        for name, inject in series.faults:
            if run.ended:
                run = resumed(run, before)
            before = name
            with verdicts.check(name):
                _await_progress(context, run, names)
                inject(run, injector)
                ended_by.append((name, run))
        if run.ended:
            run = resumed(run, before)
        with verdicts.check(before):  # the run after each of the others has shown that it was survived
            expect_end(run, 0)
            expect_identical(context, run, *lines)
        for name, ended in ended_by:
            with verdicts.check(name):
                ended.expect_clean()


def _await_progress(context: ScenarioContext, run: ObservedRun, names: Sequence[str]) -> None:
    """Wait until the streams have advanced by some frames."""
    newest = {name: newest_label_map(run.output / name) for name in names}
    frames = int(context.random.integers(1, _FRAMES_BEFORE))

    def advanced() -> bool:
        status = run.status()
        return bool(status) and all(
            newest_label_map(run.output / name) >= index + frames or status[name]["state"] == "done"
            for name, index in newest.items()
        )

    run.wait(advanced, "some frames")
    time.sleep(context.random.uniform(0, 0.2))
