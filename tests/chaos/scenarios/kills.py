"""Kill every kind of process at every step, and the command between any two steps of a commit.

Many kills come one after the other in one run, and all bytes are compared after each; a kill has a run of its
own only where nothing detects the loss, or at the end of the stream.
"""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

from chaos.harness.end_series import frames_for_ends, kill, run_end_series
from chaos.harness.fault_series import FaultSeries, Inject
from chaos.harness.injection import Injection, Injector, When
from chaos.harness.loss_series import frames_for_losses, run_loss_series
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import (
    VICTIM,
    Fault,
    Scenario,
    ScenarioContext,
    Verdicts,
    expect_end,
    expect_identical,
    single_fault,
    victim,
)

__all__ = ["COMMIT_STEPS", "KILLS", "STEPS", "Step"]

_ACTORS = "mlbs_actors.actors"
_SINKS = "orchestrator.sinks"
_STORAGE = "orchestrator.storage"

#: When a step comes: repeatedly; when a stream is started, also after a loss; at its end or seldom.
Time: TypeAlias = Literal["going on", "start", "end"]


@dataclass(frozen=True, slots=True)
class Step:
    """A step at which a process may be killed.

    Attributes
    ----------
    actor, name : str
    function : str
        As in :class:`Injection`.
    time : {"going on", "start", "end"}
    calls : int
        At which of its first calls it may be killed, at random.
    """

    actor: str
    name: str
    function: str
    time: Time
    calls: int = 1


#: Steps of each kind of actor.
STEPS: tuple[Step, ...] = (
    Step("reader", "read", f"{_ACTORS}.stream.reader:ReaderActor.read", "going on", 16),
    Step("coordinator", "begin", f"{_ACTORS}.stream.coordinator_actor:CoordinatorActor._begin", "start"),
    Step(
        "coordinator", "track", f"{_ACTORS}.stream.coordinator_actor:CoordinatorActor._track", "going on", 16
    ),
    Step(
        "coordinator", "label", f"{_ACTORS}.stream.coordinator_actor:CoordinatorActor._label", "going on", 16
    ),
    Step("coordinator", "save", f"{_ACTORS}.stream.coordinator_actor:CoordinatorActor._save", "going on"),
    Step("layer", "init", f"{_ACTORS}.stream.layer_actor:LayerActor.assign", "start"),
    Step("layer", "motion field", "mlbs_actors.layer.layer:Layer._motion_field", "going on", 16),
    Step("layer", "evaluation", "mlbs_actors.layer.layer:Layer._predict_and_evaluate", "going on"),
    Step("layer", "step", f"{_ACTORS}.stream.layer_actor:LayerActor.step", "going on", 16),
    Step("layer", "save", f"{_ACTORS}.stream.layer_actor:LayerActor.save", "going on"),
    Step("layer", "release", f"{_ACTORS}.stream.layer_actor:LayerActor.release", "end"),
    Step("segmenter", "step", f"{_ACTORS}.stream.segmenter_actor:SegmenterActor.step", "going on", 16),
    Step("segmenter", "save", f"{_ACTORS}.stream.segmenter_actor:SegmenterActor.save", "going on"),
    Step("pool", "begin", f"{_ACTORS}.node.pool:PoolActor.begin", "start"),
    Step("pool", "acquire", f"{_ACTORS}.node.pool:PoolActor.acquire", "start", 3),
    Step("pool", "release", f"{_ACTORS}.node.pool:PoolActor.release", "end"),
    Step("sink", "open", f"{_ACTORS}.stream.sink:SinkActor.open", "start"),
    Step("sink", "take", f"{_ACTORS}.stream.sink:SinkActor.take", "going on", 16),
    Step("sink", "keep", f"{_ACTORS}.stream.sink:SinkActor.keep", "going on"),
    Step("sink", "close", f"{_ACTORS}.stream.sink:SinkActor.close", "end"),
)

#: Steps of a commit, and of opening a record, in their order.
COMMIT_STEPS: tuple[Step, ...] = (
    Step("driver and sink", "take the log", f"{_STORAGE}.commit_log:CommitLog.__init__", "start"),
    Step("driver and sink", "clear up", f"{_SINKS}.record:StreamRecord._clear_up", "start"),
    Step("driver and sink", "write tables", f"{_SINKS}.record:StreamRecord._write_tables", "going on"),
    Step("driver and sink", "sync a file", "orchestrator.storage.durable_files:_sync", "going on", 32),
    Step("driver and sink", "rename a file", "pathlib:Path.replace", "going on", 32),
    Step("driver and sink", "add the line", f"{_STORAGE}.commit_log:CommitLog.add", "going on"),
    Step("driver and sink", "keep a snapshot", f"{_STORAGE}.snapshot_folder:SnapshotFolder.keep", "going on"),
    Step(
        "driver and sink",
        "forget snapshots",
        f"{_STORAGE}.snapshot_folder:SnapshotFolder.forget_before",
        "going on",
    ),
)

#: Kills of the command at any time.
_ANY_TIME = 4

#: Rows of the table of faults that the kills of each kind of process belong to.
_NUMBERS = {"reader": "12", "coordinator": "15", "segmenter": "15", "driver and sink": "19"}


def _name(step: Step, when: When) -> str:
    return f"{step.actor}: {'before' if when == 'before' else 'after'} {step.name}"


def _fault(step: Step, when: When) -> Fault:
    return Fault(_NUMBERS.get(step.actor, "13"), _name(step, when))


def _moments(step: Step) -> tuple[When, When]:
    # A process that dies right at its return dies before its answer is sent; the sink and the command die
    # together in any case.
    return ("before", "after") if step in COMMIT_STEPS else ("before", "soon after")


def _make_injection(step: Step, when: When, context: ScenarioContext, *, armed: bool = False) -> Injection:
    action: Literal["die", "kill driver"] = "kill driver" if step in COMMIT_STEPS else "die"
    process = "ray::SinkActor" if step in COMMIT_STEPS else ""
    call = int(context.random.integers(step.calls))
    return Injection(step.function, action, call, when, process=process, armed=armed)


def _provoke(step: Step, injection: Injection, run: ObservedRun, injector: Injector) -> None:
    """Arm an injection; one at the start of a process needs a loss before."""
    injector.arm(injection)
    if step.time == "start":
        run.signal_actor("ray::SegmenterActor.serve", signal.SIGKILL)


def _actor_dies(step: Step, injection: Injection) -> Inject:
    def inject(run: ObservedRun, injector: Injector) -> None:
        _provoke(step, injection, run, injector)
        run.wait(lambda: injector.has_fired(injection), "the kill")

    return inject


def _run_dies(step: Step, injection: Injection) -> Inject:
    """Kill the sink and the command at one moment, as a power cut does; the rest ends by itself."""

    def inject(run: ObservedRun, injector: Injector) -> None:
        _provoke(step, injection, run, injector)
        status, stderr = run.end(killed=True)
        expect(
            injector.has_fired(injection), f"the run ended before the kill, with status {status}: {stderr}"
        )

    return inject


def _wanted(
    steps: Sequence[Step], context: ScenarioContext, verdicts: Verdicts
) -> list[tuple[Step, When, Injection]]:
    """Return the kills at some steps that the verdicts contain, each with its injection."""
    return [
        (step, when, _make_injection(step, when, context))
        for step in steps
        for when in _moments(step)
        if _name(step, when) in verdicts
    ]


def _actors_die(steps: tuple[Step, ...], context: ScenarioContext, verdicts: Verdicts) -> None:
    kills = _wanted(steps, context, verdicts)
    losses = [(_name(step, when), _actor_dies(step, injection)) for step, when, injection in kills]
    lines, injections = [victim(frames_for_losses(len(losses)))], [injection for _, _, injection in kills]
    run_loss_series(FaultSeries(context, verdicts, losses, lines, injections))


def _runs_die(context: ScenarioContext, verdicts: Verdicts) -> None:
    kills = _wanted(COMMIT_STEPS, context, verdicts)
    ends = [(_name(step, when), _run_dies(step, injection)) for step, when, injection in kills]
    ends += [(fault.name, kill) for fault in _AT_ANY_TIME if fault.name in verdicts]
    lines, injections = [victim(frames_for_ends(len(ends)))], [injection for _, _, injection in kills]
    run_end_series(FaultSeries(context, verdicts, ends, lines, injections))


def _dies_at_the_end(step: Step, when: When, context: ScenarioContext) -> None:
    injection = _make_injection(step, when, context, armed=True)
    injector = Injector(context.folder / "injector", [injection])
    with ObservedRun([VICTIM], context.folder, injector=injector) as run:
        run.wait(lambda: injector.has_fired(injection), "the kill")
        expect_end(run, 0)
        expect_identical(context, run, VICTIM)


_AT_ANY_TIME = tuple(Fault("19", f"driver: at any time, {time}") for time in range(1, _ANY_TIME + 1))


def _series(*actors: str) -> Scenario:
    """Make a scenario of the kills of these kinds of processes that one run can survive."""
    steps = tuple(step for step in STEPS if step.actor in actors and step.time != "end")
    faults = tuple(_fault(step, when) for step in steps for when in _moments(step))
    return Scenario(", ".join(actors), faults, partial(_actors_die, steps))


#: All kills, by what is killed.
KILLS: tuple[Scenario, ...] = (
    _series("reader", "coordinator"),
    _series("layer", "segmenter"),
    _series("pool", "sink"),
    *(
        single_fault(_fault(step, when).number, _name(step, when), partial(_dies_at_the_end, step, when))
        for step in STEPS
        if step.time == "end"
        for when in _moments(step)
    ),
    Scenario(
        "driver and sink",
        (*(_fault(step, when) for step in COMMIT_STEPS for when in _moments(step)), *_AT_ANY_TIME),
        _runs_die,
    ),
)
