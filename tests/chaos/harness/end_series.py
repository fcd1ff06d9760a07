"""A run is ended in one way after the other, and gone on with by ``--resume`` at once after each."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from chaos.harness.injection import Plant, Trap
from chaos.harness.loss_series import LABELLED, newest_label_map, seconds_back
from chaos.harness.observed_run import ObservedRun
from chaos.harness.scenario import Place, Verdicts, expect_end, expect_identical, expect_prefix

__all__ = ["End", "bring_about_ends", "frames_for_ends", "kill"]

#: What a stream needs for its first snapshot, and gets on between two ends, on average at most, frames: some
#: ends come with the third commit from then on.
_FIRST_FRAMES, _FRAMES_OF_AN_END = 64, 64

#: Frames that it gets on at most before something is done to the run.
_FRAMES_BEFORE = 16


def frames_for_ends(ends: int) -> int:
    """Length of a stream that has still something to do after so many ends."""
    return _FIRST_FRAMES + _FRAMES_OF_AN_END * ends


End = Callable[[ObservedRun, Plant], None]


def kill(run: ObservedRun, plant: Plant) -> None:
    """Kill the command."""
    run.signal_driver(signal.SIGKILL)
    run.end(killed=True)


def bring_about_ends(
    place: Place,
    verdicts: Verdicts,
    ends: Sequence[tuple[str, End]],
    lines: Sequence[str],
    traps: Sequence[Trap] = (),
) -> None:
    """Run streams, end the run, go on with it, and so on up to the streams' ends.

    Parameters
    ----------
    place : Place
    verdicts : Verdicts
    ends : sequence of str and callable
        Names of faults, and what brings them about in a run. Each is done when all streams have label maps
        that they did not have before. Where the run has ended by it, the next one goes on with it.
    lines : sequence of str
        Streams, of :func:`frames_for_ends`.
    traps : sequence of Trap
        To lay in all runs.
    """
    place.prepare(lines)
    names = [line.split()[0] for line in lines]
    plant = Plant(place.folder / "plant", [LABELLED, *traps])
    with ExitStack() as runs:

        def started(*flags: str) -> ObservedRun:
            return runs.enter_context(ObservedRun(lines, place.folder, *flags, plant=plant))

        def gone_on_with(ended: ObservedRun, name: str) -> ObservedRun:
            newest = {stream: newest_label_map(ended.output / stream) for stream in names}
            began = time.monotonic()
            run = started("--resume")
            with verdicts.of(name) as verdict:
                verdict.back = seconds_back(run, plant, began, newest, lambda: newest.keys())
                expect_prefix(place, run, *lines)
            return started("--resume") if run.ended else run  # what comes next has a verdict of its own

        run, before = started(), ""
        ended_by: list[tuple[str, ObservedRun]] = []
        for name, bring_about in ends:
            if run.ended:
                run = gone_on_with(run, before)
            before = name
            with verdicts.of(name):
                _await_progress(place, run, names)
                bring_about(run, plant)
                ended_by.append((name, run))
        if run.ended:
            run = gone_on_with(run, before)
        with verdicts.of(before):  # of the others, what came next has shown that all was well
            expect_end(run, 0)
            expect_identical(place, run, *lines)
        for name, ended in ended_by:
            with verdicts.of(name):
                ended.expect_clean()


def _await_progress(place: Place, run: ObservedRun, names: Sequence[str]) -> None:
    """Wait until the streams have got on by some frames."""
    newest = {name: newest_label_map(run.output / name) for name in names}
    frames = int(place.random.integers(1, _FRAMES_BEFORE))

    def got_on() -> bool:
        status = run.status()
        return bool(status) and all(
            newest_label_map(run.output / name) >= index + frames or status[name]["state"] == "done"
            for name, index in newest.items()
        )

    run.wait(got_on, "some frames")
    time.sleep(place.random.uniform(0, 0.2))
