"""Every kind of process killed at every step, and the command killed between any two steps of a commit."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from orchestrator.chaos.lost_processes import driver_killed, resumed
from orchestrator.chaos.observed_run import ObservedRun, expect
from orchestrator.chaos.place import VICTIM, Fault, Place, expect_end, expect_identical
from orchestrator.chaos.planted import Plant, Trap, When

__all__ = ["COMMIT_STEPS", "KILLS", "STEPS"]

_ACTORS = "mlbs_actors.actors"
_SINKS = "orchestrator.sinks"

#: A stream alone: the whole table is long. What a loss does to the streams beside is seen among the faults.
_LINES = (VICTIM,)

#: Steps of each kind of actor: what it is, its function, and up to which of its calls it may be hit.
STEPS: tuple[tuple[str, str, str, int], ...] = (
    ("reader", "read", f"{_ACTORS}.reader:ReaderActor.read", 40),
    ("coordinator", "begin", f"{_ACTORS}.coordinator:CoordinatorActor._begin", 1),
    ("coordinator", "track", f"{_ACTORS}.coordinator:CoordinatorActor._track", 40),
    ("coordinator", "label", f"{_ACTORS}.coordinator:CoordinatorActor._label", 40),
    ("coordinator", "save", f"{_ACTORS}.coordinator:CoordinatorActor._save", 1),
    ("layer", "init", f"{_ACTORS}.layer:LayerActor.assign", 1),
    ("layer", "motion field", "mlbs_actors.gabp:motion_field", 20),
    ("layer", "warp and KDE", "mlbs_actors.kde:warp_and_evaluate", 20),
    ("layer", "step", f"{_ACTORS}.layer:LayerActor.step", 20),
    ("layer", "save", f"{_ACTORS}.layer:LayerActor.save", 1),
    ("layer", "release", f"{_ACTORS}.layer:LayerActor.release", 1),
    ("segmenter", "step", f"{_ACTORS}.segmenter:SegmenterActor.step", 40),
    ("segmenter", "save", f"{_ACTORS}.segmenter:SegmenterActor.save", 1),
    ("pool", "begin", f"{_ACTORS}.pool:PoolActor.begin", 1),
    ("pool", "acquire", f"{_ACTORS}.pool:PoolActor.acquire", 3),
    ("pool", "release", f"{_ACTORS}.pool:PoolActor.release", 1),
    ("sink", "open", f"{_ACTORS}.sink:SinkActor.open", 1),
    ("sink", "write", f"{_ACTORS}.sink:SinkActor.write", 40),
    ("sink", "keep", f"{_ACTORS}.sink:SinkActor.keep", 1),
    ("sink", "close", f"{_ACTORS}.sink:SinkActor.close", 1),
)

#: Steps of a commit, and of opening and closing a record, in their order.
COMMIT_STEPS: tuple[tuple[str, str, int], ...] = (
    ("take the log", f"{_SINKS}.commit_log:CommitLog.__init__", 1),
    ("clear up", f"{_SINKS}.record:StreamRecord._clear_up", 1),
    ("write tables", f"{_SINKS}.record:StreamRecord._write_tables", 3),
    ("sync a file", "orchestrator.durable_files:_sync", 50),
    ("rename a file", "pathlib:Path.replace", 40),
    ("add the line", f"{_SINKS}.commit_log:CommitLog.add", 3),
    ("keep a snapshot", f"{_SINKS}.snapshot_folder:SnapshotFolder.keep", 1),
    ("forget snapshots", f"{_SINKS}.snapshot_folder:SnapshotFolder.forget_before", 3),
)

#: Kills of the command at any time.
_ANY_TIME = 4


def _actor_dies(function: str, when: When, calls: int, place: Place) -> None:
    trap = Trap(function, "die", int(place.random.integers(calls)), when)
    plant = Plant(place.folder / "plant", [trap])
    with ObservedRun(_LINES, place.folder, plant=plant) as run:
        run.wait(lambda: plant.sprung > 0, "the kill")
        expect_end(run, 0)
        expect_identical(place, run, "victim")


def _run_dies(function: str, when: When, calls: int, place: Place) -> float:
    """The sink and the command are killed at one moment, as by a power cut; the rest ends as it may."""
    call = int(place.random.integers(calls))
    trap = Trap(function, "kill driver", call, when, process="ray::SinkActor")
    plant = Plant(place.folder / "plant", [trap])
    with ObservedRun(_LINES, place.folder, plant=plant) as run:
        status, words = run.end(killed=True)
        expect(plant.sprung > 0, f"the run ended before the kill, with status {status}: {words}")
        return resumed(place, _LINES)


def _kills() -> tuple[Fault, ...]:
    kills: list[Fault] = []

    def add(number: str, name: str, bring_about: Callable[[Place], float | None]) -> None:
        kills.append(Fault(number, name, bring_about))

    for kind, step, function, calls in STEPS:
        number = "15" if kind in ("coordinator", "segmenter") else "12" if kind == "reader" else "13"
        add(number, f"{kind}: before {step}", partial(_actor_dies, function, "before", calls))
        add(number, f"{kind}: after {step}", partial(_actor_dies, function, "soon after", calls))
    for step, function, calls in COMMIT_STEPS:
        add("19", f"driver and sink: before {step}", partial(_run_dies, function, "before", calls))
        add("19", f"driver and sink: after {step}", partial(_run_dies, function, "after", calls))
    for time in range(1, _ANY_TIME + 1):
        add("19", f"driver: at any time, {time}", partial(driver_killed, lines=_LINES))
    return tuple(kills)


#: All of them, by kind.
KILLS = _kills()
