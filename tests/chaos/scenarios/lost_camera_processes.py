"""Kill processes of a camera's stream, and its run: what the camera delivered is labelled as ever."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from chaos.harness.camera import RATE, Camera, as_received, play
from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ObservedRun, content, expect, labelled
from chaos.harness.reference import label_in_process
from chaos.harness.scenario import RecoveryTime, ScenarioContext, expect_end, expect_no_secret, single_fault
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene

__all__ = ["SCENARIOS"]

_FOREVER = 1_000_000

#: Label maps that are committed before each kill, beyond those at the kill before.
_BETWEEN = 8

#: Titles of processes at work; the loss of the reader is the only one that costs pictures.
_KINDS = (
    "ray::SegmenterActor.serve",
    "ray::LayerActor.serve",
    "ray::LiveReaderActor",
    "ray::CoordinatorActor.advance",
    "ray::PoolActor",
    "ray::SinkActor",
)


class _CameraStream:
    """A camera whose every connection begins with its first picture, and the runs over it."""

    def __init__(self, context: ScenarioContext) -> None:
        made = scene("demo", frames=100, width=160, height=120)
        self._pictures = [made.frame(t) for t in range(100)]
        self._context = context
        self.camera = Camera(self._pictures, lambda number: play(0, _FOREVER, time.monotonic()))

    def run(self, *flags: str, injector: Injector | None = None) -> ObservedRun:
        return ObservedRun([f"door {self.camera.address}"], self._context.folder, *flags, injector=injector)

    def interrupt(self, run: ObservedRun, gaps: int) -> None:
        """End a run; expect that its rows are true, and its label maps those of the pictures received."""
        run.signal_driver(signal.SIGTERM)
        expect_no_secret(run, expect_end(run, 0), self.camera.password)
        door = run.status()["door"]
        rows: list[dict[str, Any]] = content(run.output / "door")["frames"]
        statuses = [row["status"] for row in rows]
        with_labels = labelled(rows)
        counted = {"labelled": len(with_labels)} | {key: statuses.count(key) for key in ("dropped", "gap")}
        reported = {"labelled": door["committed"], "dropped": door["dropped"], "gap": door["gaps"]}
        expect(counted == reported, f"the rows are {counted}, the status says {reported}")
        expect(counted["gap"] == gaps, f"{counted['gap']} gaps are reported instead of {gaps}")
        expect(
            door["read"] == counted["labelled"] + counted["dropped"], f"{door['read']} were read, {counted}"
        )
        times = [row["pts"] for row in rows]
        expect(times == sorted(times), "the times go back")
        for row, labels in zip(with_labels, label_in_process(self._given(rows)), strict=True):
            mask = np.asarray(Image.open(run.output / "door/masks" / f"{row['name']}.png"))
            expect(bool((mask == labels).all()), f"frame {row['frame']} is labelled otherwise")

    def _given(self, rows: Sequence[dict[str, Any]]) -> list[Array]:
        """Return the pictures of the labelled rows: after a gap the camera has started again."""
        given, began, last = [], 0.0, None
        most = 1 + round((rows[-1]["pts"] - rows[0]["pts"]) * RATE)
        received = as_received(self._pictures, most)
        for row in rows:
            if row["status"] != "gap" and last in (None, "gap"):
                began = row["pts"]
            if labelled([row]):
                given.append(received[round((row["pts"] - began) * RATE)])
            last = row["status"]
        return given


def _wait_for_more(run: ObservedRun, returns: int) -> None:
    """Wait until the stream has gone back so often and committed more than it had."""
    run.wait(lambda: run.status().get("door", {"returns": -1})["returns"] >= returns, "the loss noticed")
    before = run.status()["door"]["committed"]
    run.wait(lambda: run.status()["door"]["committed"] >= before + _BETWEEN, "more label maps")


def _killed_in_turn(context: ScenarioContext) -> RecoveryTime:
    """Return the time from the last kill until there were more label maps than ever before."""
    door = _CameraStream(context)
    with door.camera, door.run() as run:
        for returns, title in enumerate(context.random.permutation(_KINDS).tolist()):
            _wait_for_more(run, returns)
            time.sleep(context.random.uniform(0, 1.0))
            killed = time.monotonic()
            run.signal_actor(title, signal.SIGKILL, int(context.random.integers(8)))
        _wait_for_more(run, len(_KINDS))
        seconds = time.monotonic() - killed
        door.interrupt(run, gaps=1)
        return RecoveryTime(seconds)


def _killed_while_slow(context: ScenarioContext) -> None:
    """Kill a part of a stream whose camera is faster than labelling and writing."""
    steps = (
        "mlbs_actors.actors.stream.segmenter_actor:SegmenterActor.step",
        "orchestrator.sinks.record:StreamRecord.write",
    )
    slow = [Injection(step, "wait", value=context.random.uniform(0.1, 0.2)) for step in steps]
    door = _CameraStream(context)
    with door.camera, door.run(injector=Injector(context.folder / "injector", slow)) as run:
        _wait_for_more(run, 0)
        run.signal_actor(str(context.random.choice(_KINDS[:2])), signal.SIGKILL)
        _wait_for_more(run, 1)
        expect(run.status()["door"]["dropped"] > 0, "nothing was dropped")
        door.interrupt(run, gaps=0)


def _run_killed(context: ScenarioContext) -> RecoveryTime:
    door = _CameraStream(context)
    with door.camera:
        with door.run() as run:
            _wait_for_more(run, 0)
            time.sleep(context.random.uniform(0, 2.0))
            run.signal_driver(signal.SIGKILL)
            run.end(killed=True)
        resumed = time.monotonic()
        with door.run("--resume") as run:
            _wait_for_more(run, 0)
            seconds = time.monotonic() - resumed
            door.interrupt(run, gaps=1)
            return RecoveryTime(seconds)


SCENARIOS = (
    single_fault("12 13 15", "a live source, every process killed in turn", _killed_in_turn),
    single_fault("24 25", "a live source, slow sink and pipeline, a part killed", _killed_while_slow),
    single_fault("19", "a live source, driver killed, then --resume", _run_killed),
)
