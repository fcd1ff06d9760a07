"""Every kind of process killed at every step, and the command killed between any two steps of a commit.

Many kills come one after the other in one run, and all bytes are compared after each; a run is started for
each kill only where the loss is noticed by nobody, or at the end of the stream.
"""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

from chaos.harness.end_series import End, bring_about_ends, frames_for_ends, kill
from chaos.harness.injection import Plant, Trap, When
from chaos.harness.loss_series import Loss, bring_about_losses, frames_for_losses
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import (
    VICTIM,
    Fault,
    Place,
    Scenario,
    Verdicts,
    alone,
    expect_end,
    expect_identical,
    victim,
)

__all__ = ["COMMIT_STEPS", "KILLS", "STEPS", "Step"]

_ACTORS = "mlbs_actors.actors"
_SINKS = "orchestrator.sinks"

#: When a step comes: again and again; when a stream is started, also after a loss; seldom, or at its end.
Time: TypeAlias = Literal["going on", "start", "end"]


@dataclass(frozen=True, slots=True)
class Step:
    """What a process may be killed at.

    Attributes
    ----------
    actor, name : str
    function : str
        As in :class:`Trap`.
    time : {"going on", "start", "end"}
    calls : int
        Up to which of its calls it may be hit.
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
    Step("driver and sink", "take the log", f"{_SINKS}.commit_log:CommitLog.__init__", "start"),
    Step("driver and sink", "clear up", f"{_SINKS}.record:StreamRecord._clear_up", "start"),
    Step("driver and sink", "write tables", f"{_SINKS}.record:StreamRecord._write_tables", "going on"),
    Step("driver and sink", "sync a file", "orchestrator.run.durable_files:_sync", "going on", 32),
    Step("driver and sink", "rename a file", "pathlib:Path.replace", "going on", 32),
    Step("driver and sink", "add the line", f"{_SINKS}.commit_log:CommitLog.add", "going on"),
    Step("driver and sink", "keep a snapshot", f"{_SINKS}.snapshot_folder:SnapshotFolder.keep", "going on"),
    Step(
        "driver and sink",
        "forget snapshots",
        f"{_SINKS}.snapshot_folder:SnapshotFolder.forget_before",
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


def _trap(step: Step, when: When, place: Place, *, armed: bool = False) -> Trap:
    action: Literal["die", "kill driver"] = "kill driver" if step in COMMIT_STEPS else "die"
    process = "ray::SinkActor" if step in COMMIT_STEPS else ""
    call = int(place.random.integers(step.calls))
    return Trap(step.function, action, call, when, process=process, armed=armed)


def _provoke(step: Step, trap: Trap, run: ObservedRun, plant: Plant) -> None:
    """Arm a trap; one at a start needs a loss before."""
    plant.arm(trap)
    if step.time == "start":
        run.signal_actor("ray::SegmenterActor.serve", signal.SIGKILL)


def _actor_dies(step: Step, trap: Trap) -> Loss:
    def bring_about(run: ObservedRun, plant: Plant) -> None:
        _provoke(step, trap, run, plant)
        run.wait(lambda: plant.has_sprung(trap), "the kill")

    return bring_about


def _run_dies(step: Step, trap: Trap) -> End:
    """The sink and the command are killed at one moment, as by a power cut; the rest ends as it may."""

    def bring_about(run: ObservedRun, plant: Plant) -> None:
        _provoke(step, trap, run, plant)
        status, words = run.end(killed=True)
        expect(plant.has_sprung(trap), f"the run ended before the kill, with status {status}: {words}")

    return bring_about


def _wanted(steps: Sequence[Step], place: Place, verdicts: Verdicts) -> list[tuple[Step, When, Trap]]:
    """The kills at some steps that a verdict is asked for, each with its trap."""
    return [
        (step, when, _trap(step, when, place))
        for step in steps
        for when in _moments(step)
        if _name(step, when) in verdicts
    ]


def _actors_die(steps: tuple[Step, ...], place: Place, verdicts: Verdicts) -> None:
    kills = _wanted(steps, place, verdicts)
    losses = [(_name(step, when), _actor_dies(step, trap)) for step, when, trap in kills]
    lines = (victim(frames_for_losses(len(losses))),)
    bring_about_losses(place, verdicts, losses, lines, [trap for _, _, trap in kills])


def _runs_die(place: Place, verdicts: Verdicts) -> None:
    kills = _wanted(COMMIT_STEPS, place, verdicts)
    ends = [(_name(step, when), _run_dies(step, trap)) for step, when, trap in kills]
    ends += [(fault.name, kill) for fault in _AT_ANY_TIME if fault.name in verdicts]
    lines = (victim(frames_for_ends(len(ends))),)
    bring_about_ends(place, verdicts, ends, lines, [trap for _, _, trap in kills])


def _dies_at_the_end(step: Step, when: When, place: Place) -> None:
    trap = _trap(step, when, place, armed=True)
    plant = Plant(place.folder / "plant", [trap])
    with ObservedRun([VICTIM], place.folder, plant=plant) as run:
        run.wait(lambda: plant.has_sprung(trap), "the kill")
        expect_end(run, 0)
        expect_identical(place, run, VICTIM)


_AT_ANY_TIME = tuple(Fault("19", f"driver: at any time, {time}") for time in range(1, _ANY_TIME + 1))


def _series(*actors: str) -> Scenario:
    """The kills of these kinds of processes that can be brought about in one run."""
    steps = tuple(step for step in STEPS if step.actor in actors and step.time != "end")
    faults = tuple(_fault(step, when) for step in steps for when in _moments(step))
    return Scenario(", ".join(actors), faults, partial(_actors_die, steps))


#: All of them, by what is killed.
KILLS: tuple[Scenario, ...] = (
    _series("reader", "coordinator"),
    _series("layer", "segmenter"),
    _series("pool", "sink"),
    *(
        alone(_fault(step, when).number, _name(step, when), partial(_dies_at_the_end, step, when))
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
