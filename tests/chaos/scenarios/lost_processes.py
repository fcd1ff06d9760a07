"""Processes of a run that are killed, hang, abort or never start."""

from __future__ import annotations

import signal
import time

from chaos.harness.injection import Plant, Trap, When
from chaos.harness.loss_series import Loss, bring_about_losses, frames_for_losses
from chaos.harness.observed_run import ObservedRun, content, expect
from chaos.harness.scenario import (
    VICTIM,
    Fault,
    Place,
    Scenario,
    Verdicts,
    alone,
    beside,
    expect_end,
    expect_prefix,
    victim,
)
from chaos.scenarios.damaged_sources import write_video
from orchestrator.sources.synthetic import scene

__all__ = ["SCENARIOS"]

#: Streams beside the one whose decoding aborts its process.
_GOOD = 7

#: After this time a burst of frames counts as hanging, in the run where one hangs, s.
_HANG_SECONDS = 45.0

#: Processes of which one is killed at its work: the row's number and name, the process's title then.
_KILLED = (
    ("12", "reader killed", "ray::ReaderActor.serve"),
    ("13", "layer killed", "ray::LayerActor.serve"),
    ("13", "pool killed", "ray::PoolActor"),
    ("13", "sink killed", "ray::SinkActor"),
    ("15", "coordinator killed", "ray::CoordinatorActor.advance"),
    ("15", "segmenter killed", "ray::SegmenterActor.serve"),
)
_WHILE_SAVING = Fault("14", "a process killed while it writes a snapshot")
_HANGS = Fault("17", f"layer hangs ({_HANG_SECONDS:.0f} s of patience)")


def _signalled(title: str, number: signal.Signals, pause: float, choice: int) -> Loss:
    def bring_about(run: ObservedRun, plant: Plant) -> None:
        time.sleep(pause)
        run.signal_actor(title, number, choice)

    return bring_about


def _sprung(trap: Trap) -> Loss:
    def bring_about(run: ObservedRun, plant: Plant) -> None:
        plant.arm(trap)
        run.wait(lambda: plant.has_sprung(trap), "the trap snapped")

    return bring_about


def _one_after_the_other(place: Place, verdicts: Verdicts) -> None:
    """All losses in one run, beside a stream that is in it too; in another order for each seed."""
    random = place.random
    when: When = "before" if random.integers(2) else "after"
    kind = str(random.choice(["Layer", "Coordinator", "Segmenter"]))
    saving = Trap(
        "mlbs_actors.state_file:CapturedState.write", "die", when=when, process=f"ray::{kind}", armed=False
    )
    sooner = Trap("orchestrator.run.recovery:STALL_SECONDS", "set", value=_HANG_SECONDS)

    def hit(title: str, number: signal.Signals) -> Loss:
        return _signalled(title, number, random.uniform(0, 0.5), int(random.integers(8)))

    losses = [(name, hit(title, signal.SIGKILL)) for _, name, title in _KILLED]
    losses += [(_WHILE_SAVING.name, _sprung(saving))]
    losses += [(_HANGS.name, hit("ray::LayerActor.serve", signal.SIGSTOP))]
    losses = [losses[number] for number in random.permutation(len(losses)) if losses[number][0] in verdicts]
    frames = frames_for_losses(len(losses))
    bring_about_losses(place, verdicts, losses, (victim(frames), beside(frames)), (saving, sooner))


def _dies_at_every_start(place: Place) -> None:
    with ObservedRun([VICTIM], place.folder) as run:
        run.wait_for_frames("victim", 1)
        while run.status()["victim"]["state"] not in ("failed", "done", "partial"):
            for pid in run.processes("ray::SegmenterActor"):
                run.signal_process(pid, signal.SIGKILL)
            time.sleep(0.2)
        words = expect_end(run, 1)
        expect("segmenter" in words, f"the error does not name the part: {words}")
        expect_prefix(place, run, VICTIM)


def _decoding_aborts(place: Place) -> None:
    """A file whose decoding aborts the process, every time at the same frame, next to seven good streams."""
    lines = [f"good{seed} 'synthetic:demo?frames=20&width=96&height=72&seed={seed}'" for seed in range(_GOOD)]
    made = scene("demo", frames=20, width=96, height=72)
    write_video(place.folder / "aborts.mkv", [made.frame(t) for t in range(20)])
    frame = int(place.random.integers(3, 20))
    abort = Trap("orchestrator.sources.video:VideoReader.read", "abort", frame, times=100)
    all_lines = list(lines)
    all_lines.insert(int(place.random.integers(_GOOD + 1)), "aborts aborts.mkv")
    with ObservedRun(all_lines, place.folder, plant=Plant(place.folder / "plant", [abort])) as run:
        words = expect_end(run, 1)
        aborted = run.status()["aborts"]
        # The frame before may have been on its way out of the process.
        whole_enough = aborted["state"] == "partial" and frame - 1 <= aborted["committed"] <= frame
        expect(whole_enough, f"it is told as {aborted}")
        expect(f"died after {aborted['committed']} frames" in words, f"the error is not told: {words}")
        for number, line in enumerate(lines):
            whole = content(run.output / f"good{number}") == place.expected(line)
            expect(whole, f"good{number} is not as without the fault")
            expect(run.status()[f"good{number}"]["returns"] == 0, f"good{number} was disturbed")


SCENARIOS = (
    Scenario(
        "processes lost one after the other",
        (*(Fault(number, name) for number, name, _ in _KILLED), _WHILE_SAVING, _HANGS),
        _one_after_the_other,
    ),
    alone("12", f"decoding aborts the process, beside {_GOOD} others", _decoding_aborts),
    alone("16", "segmenter dies at every start", _dies_at_every_start),
)
