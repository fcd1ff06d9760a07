"""Kill, stop or abort processes of a run, or let them never start."""

from __future__ import annotations

import signal
import time

from chaos.harness.fault_series import FaultSeries, Inject
from chaos.harness.injection import Injection, Injector, When
from chaos.harness.loss_series import frames_for_losses, run_loss_series
from chaos.harness.observed_run import ObservedRun, content, expect
from chaos.harness.scenario import (
    VICTIM,
    Fault,
    Scenario,
    ScenarioContext,
    Verdicts,
    bystander,
    expect_end,
    expect_prefix,
    single_fault,
    victim,
)
from chaos.scenarios.damaged_sources import write_video
from mlbs_actors.scenes.synthetic import scene

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


def _send_signal(title: str, number: signal.Signals, pause: float, choice: int) -> Inject:
    def inject(run: ObservedRun, injector: Injector) -> None:
        time.sleep(pause)
        run.signal_actor(title, number, choice)

    return inject


def _wait_until_fired(injection: Injection) -> Inject:
    def inject(run: ObservedRun, injector: Injector) -> None:
        injector.arm(injection)
        run.wait(lambda: injector.has_fired(injection), "the injected fault")

    return inject


def _one_after_the_other(context: ScenarioContext, verdicts: Verdicts) -> None:
    """Inject all losses into one run with a bystander, in another order for each seed."""
    random = context.random
    when: When = "before" if random.integers(2) else "after"
    kind = str(random.choice(["Layer", "Coordinator", "Segmenter"]))
    saving = Injection(
        "mlbs_actors.state_file:CapturedState.write", "die", when=when, process=f"ray::{kind}", armed=False
    )
    sooner = Injection("orchestrator.run.recovery:STALL_SECONDS", "set", value=_HANG_SECONDS)

    def hit(title: str, number: signal.Signals) -> Inject:
        return _send_signal(title, number, random.uniform(0, 0.5), int(random.integers(8)))

    losses = [(name, hit(title, signal.SIGKILL)) for _, name, title in _KILLED]
    losses += [(_WHILE_SAVING.name, _wait_until_fired(saving))]
    losses += [(_HANGS.name, hit("ray::LayerActor.serve", signal.SIGSTOP))]
    losses = [losses[number] for number in random.permutation(len(losses)) if losses[number][0] in verdicts]
    frames = frames_for_losses(len(losses))
    lines = victim(frames), bystander(frames)
    run_loss_series(FaultSeries(context, verdicts, losses, lines, (saving, sooner)))


def _dies_at_every_start(context: ScenarioContext) -> None:
    with ObservedRun([VICTIM], context.folder) as run:
        run.wait_for_frames("victim", 1)
        while run.status()["victim"]["state"] not in ("failed", "done", "partial"):
            for pid in run.processes("ray::SegmenterActor"):
                run.signal_process(pid, signal.SIGKILL)
            time.sleep(0.2)
        stderr = expect_end(run, 1)
        expect("segmenter" in stderr, f"the error does not name the part: {stderr}")
        expect_prefix(context, run, VICTIM)


def _decoding_aborts(context: ScenarioContext) -> None:
    """Run a file whose decoding aborts the process, always at the same frame, beside seven good streams."""
    lines = [f"good{seed} 'synthetic:demo?frames=20&width=96&height=72&seed={seed}'" for seed in range(_GOOD)]
    made = scene("demo", frames=20, width=96, height=72)
    write_video(context.folder / "aborts.mkv", [made.frame(t) for t in range(20)])
    frame = int(context.random.integers(3, 20))
    abort = Injection("orchestrator.sources.video:VideoReader.read", "abort", frame, times=100)
    all_lines = list(lines)
    all_lines.insert(int(context.random.integers(_GOOD + 1)), "aborts aborts.mkv")
    with ObservedRun(
        all_lines, context.folder, injector=Injector(context.folder / "injector", [abort])
    ) as run:
        stderr = expect_end(run, 1)
        aborted = run.status()["aborts"]
        # The frame before may have been on its way out of the process.
        whole_enough = aborted["state"] == "partial" and frame - 1 <= aborted["committed"] <= frame
        expect(whole_enough, f"it is reported as {aborted}")
        expect(f"died after {aborted['committed']} frames" in stderr, f"the error is not reported: {stderr}")
        for number, line in enumerate(lines):
            whole = content(run.output / f"good{number}") == context.expected(line)
            expect(whole, f"good{number} is not as without the fault")
            expect(run.status()[f"good{number}"]["returns"] == 0, f"good{number} was disturbed")


SCENARIOS = (
    Scenario(
        "processes lost one after the other",
        (*(Fault(number, name) for number, name, _ in _KILLED), _WHILE_SAVING, _HANGS),
        _one_after_the_other,
    ),
    single_fault("12", f"decoding aborts the process, beside {_GOOD} others", _decoding_aborts),
    single_fault("16", "segmenter dies at every start", _dies_at_every_start),
)
