"""Cameras that refuse, stall and hang up, and parts that are too slow for their source."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from PIL import Image

from chaos.harness.camera import RATE, Camera, as_received, play
from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ObservedRun, content, expect, labelled
from chaos.harness.reference import label_in_process
from chaos.harness.scenario import (
    BYSTANDER,
    LINES,
    Fault,
    RecoveryTime,
    Scenario,
    ScenarioContext,
    Verdicts,
    expect_end,
    expect_identical,
    expect_no_secret,
    single_fault,
)
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene

__all__ = ["SCENARIOS"]

#: Label maps to make of a camera.
_LABEL_MAPS = 120

#: What connecting and a busy machine may add to a pause, s.
_LATE = 3.0

#: Frames that may be read and not yet written: in a burst, in the parts, on their way to the sink.
_MOST_FRAMES_AHEAD = 24

_FOREVER = 1_000_000

#: Connections that a camera refuses before it accepts.
_REFUSALS = 4


def _pictures() -> list[Array]:
    made = scene("demo", frames=100, width=160, height=120)
    return [made.frame(t) for t in range(100)]


def _expect_consistent_rows(run: ObservedRun, name: str, gaps: int) -> list[dict[str, Any]]:
    """Expect that the rows and the status of a camera agree; return the rows."""
    door = run.status()[name]
    rows: list[dict[str, Any]] = content(run.output / name)["frames"]
    statuses = [row["status"] for row in rows]
    reported = {"labelled": door["committed"], "dropped": door["dropped"], "gap": door["gaps"]}
    expect(
        door["state"] == "done" and door["committed"] == _LABEL_MAPS,
        f"the camera's stream is reported as {door}",
    )
    counted = {"labelled": len(labelled(rows))} | {key: statuses.count(key) for key in ("dropped", "gap")}
    expect(counted == reported, f"the rows are {counted}, the status says {reported}")
    expect(reported["gap"] == gaps, f"{reported['gap']} gaps are reported instead of {gaps}")
    times = [row["pts"] for row in rows]
    expect(times == sorted(times), "the times go back")
    return rows


def _expect_pauses(camera: Camera, failures: int, hung_up: Sequence[float]) -> None:
    """Expect attempts after growing pauses, within their bounds."""
    for number in range(failures):
        longest = min(0.5 * 2.0**number, 30.0)
        pause = camera.connected[number + 1] - hung_up[number]
        expect(longest / 2 - 0.1 <= pause <= longest + _LATE, f"pause {number} was {pause:.1f} s")


def _refusing(number: int) -> Iterator[int] | None:
    return None if number < _REFUSALS else play(0, _FOREVER, time.monotonic())


def _stalling(silence: float) -> Callable[[int], Iterator[int]]:
    """Make a script with a silence that ends by itself, or after which the client has to reconnect."""
    began = time.monotonic()

    def script(number: int) -> Iterator[int]:
        if number == 0:
            began_sending = time.monotonic()
            yield from play(0, 30, began_sending)
            time.sleep(silence)
            yield from play(30 + round(silence * RATE), _FOREVER, began_sending)
        else:
            yield from play(round((time.monotonic() - began) * RATE), _FOREVER, began)

    return script


def _flapping(flaps: int, length: int, hung_up: list[float]) -> Callable[[int], Iterator[int]]:
    """Make a script in which so many connections end after some pictures; append when to ``hung_up``."""
    began = time.monotonic()

    def script(number: int) -> Iterator[int]:
        first = round((time.monotonic() - began) * RATE)
        yield from play(first, _FOREVER if number == flaps else first + length, began)
        hung_up.append(time.monotonic())

    return script


_REFUSES = Fault("3", "a camera refuses four times")
_STALLS = Fault("4", "a camera stalls without an error")
_FLAPS = Fault("5", "a flapping camera")


def _cameras(context: ScenarioContext, verdicts: Verdicts) -> None:
    """Run faulty cameras and a file as bystander: every gap and drop is reported."""
    pictures = _pictures()
    silence = float(context.random.choice([6.5, 13.0]))
    flaps, length = int(context.random.integers(2, 4)), int(context.random.integers(5, 20))
    hung_up: list[float] = []
    with (
        Camera(pictures, _refusing) as refusing,
        Camera(pictures, _stalling(silence)) as stalling,
        Camera(pictures, _flapping(flaps, length, hung_up)) as flapping,
    ):
        cameras = {"refuses": refusing, "stalls": stalling, "flaps": flapping}
        lines = [f"{name} {camera.address}" for name, camera in cameras.items()]
        with ObservedRun([*lines, BYSTANDER], context.folder, "--max-frames", str(_LABEL_MAPS)) as run:
            stderr = expect_end(run, 0)
            for fault, name, gaps in (
                (_REFUSES, "refuses", 0),
                (_STALLS, "stalls", 1),
                (_FLAPS, "flaps", flaps),
            ):
                with verdicts.check(fault.name):
                    _expect_consistent_rows(run, name, gaps)
                    expect_no_secret(run, stderr, Camera.password)
                    expect_identical(context, run, BYSTANDER)
            with verdicts.check(_REFUSES.name) as verdict:
                _expect_pauses(refusing, _REFUSALS, refusing.connected)
                verdict.recovery = RecoveryTime(refusing.connected[_REFUSALS] - refusing.connected[0])
            with verdicts.check(_STALLS.name):
                connections = len(stalling.connected)
                expect(connections == (1 if silence < 10 else 2), f"{connections} connections")
            with verdicts.check(_FLAPS.name) as verdict:
                _expect_pauses(flapping, flaps, hung_up)
                pauses = zip(hung_up, flapping.connected[1:], strict=False)
                verdict.recovery = RecoveryTime(max(back - away for away, back in pauses))


def _slow_pipeline(context: ScenarioContext) -> None:
    """Run a camera that is faster than labelling: as if only the labelled pictures had been sent."""
    slow = Injection(
        "mlbs_actors.actors.stream.segmenter_actor:SegmenterActor.step",
        "wait",
        value=context.random.uniform(0.1, 0.3),
    )
    pictures = _pictures()
    injector = Injector(context.folder / "injector", [slow])
    with Camera(pictures, lambda number: play(0, _FOREVER, time.monotonic())) as camera:
        lines, flags = [f"door {camera.address}"], ("--max-frames", str(_LABEL_MAPS))
        with ObservedRun(lines, context.folder, *flags, injector=injector) as run:
            expect_no_secret(run, expect_end(run, 0), camera.password)
            rows = _expect_consistent_rows(run, "door", 0)
            dropped = sum(row["status"] == "dropped" for row in rows)
            expect(dropped > _LABEL_MAPS // 4, f"only {dropped} pictures were dropped")
            with_labels = labelled(rows)
            received = as_received(pictures, 1 + round(rows[-1]["pts"] * RATE))
            given = [received[round(row["pts"] * RATE)] for row in with_labels]
            for row, labels in zip(with_labels, label_in_process(given), strict=True):
                mask = np.asarray(Image.open(run.output / "door/masks" / f"{row['name']}.png"))
                expect(bool((mask == labels).all()), f"frame {row['frame']} is labelled otherwise")


def _off_at_the_start(context: ScenarioContext) -> None:
    """Switch a camera on when the stream beside it has long ended."""
    pictures = _pictures()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    line = f"door rtsp://bob:{Camera.password}@127.0.0.1:{port}/door"
    with ObservedRun([line, BYSTANDER], context.folder, "--max-frames", str(_LABEL_MAPS)) as run:
        run.wait(lambda: run.status().get("bystander", {}).get("state") == "done", "the other stream's end")
        run.wait(lambda: run.status()["door"]["state"] == "reconnecting", "the camera reported as away")
        seen = set()
        until = time.monotonic() + context.random.uniform(3.0, 12.0)
        while time.monotonic() < until:
            door = run.status()["door"]
            seen.add((door["state"], door["error"]))
            time.sleep(0.1)
        expect(len(seen) == 1, f"the camera's state is not steady: {seen}")
        with Camera(pictures, lambda number: play(0, _FOREVER, time.monotonic()), port):
            stderr = expect_end(run, 0)
        _expect_consistent_rows(run, "door", 0)
        expect_no_secret(run, stderr, Camera.password)
        expect_identical(context, run, BYSTANDER)


def _slow_sink(context: ScenarioContext) -> None:
    """Run with a disk that is slower than labelling: reading a file waits for it."""
    slow = Injection(
        "orchestrator.sinks.record:StreamRecord.write", "wait", value=context.random.uniform(0.2, 0.4)
    )
    ahead = [0]

    def finished(run: ObservedRun) -> bool:
        written = len([*run.output.glob("victim/masks/*"), *run.output.glob("victim/masks/.*.part")])
        victim = run.status().get("victim", {"read": 0, "state": "waiting"})
        ahead.append(victim["read"] - written)
        return bool(victim["state"] == "done")

    with ObservedRun(LINES, context.folder, injector=Injector(context.folder / "injector", [slow])) as run:
        run.wait(lambda: finished(run), "victim at its end")
        expect_end(run, 0)
        expect_identical(context, run)
        expect(max(ahead) <= _MOST_FRAMES_AHEAD, f"{max(ahead)} frames were read and not written")


SCENARIOS = (
    Scenario("cameras that go wrong", (_REFUSES, _STALLS, _FLAPS), _cameras),
    single_fault("3", "a camera off at the start", _off_at_the_start),
    single_fault("24", "slow sink, a file as source", _slow_sink),
    single_fault("25", "slow pipeline, a live source", _slow_pipeline),
)
