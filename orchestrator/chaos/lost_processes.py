"""Processes of a run that are killed, hang, abort or never start, and the command itself."""

from __future__ import annotations

import pickle
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from orchestrator.chaos.damaged_sources import write_video
from orchestrator.chaos.observed_run import ObservedRun, content, expect
from orchestrator.chaos.place import (
    FRAMES,
    LINES,
    Fault,
    Place,
    expect_end,
    expect_identical,
    seconds_until_back,
    states_of,
)
from orchestrator.chaos.planted import Plant, Trap, When
from orchestrator.sources.synthetic import scene

__all__ = ["FAULTS", "driver_killed", "resumed"]

#: Streams beside the one whose decoding aborts its process.
_GOOD = 7

#: After this time a burst of frames counts as hanging, in the run where one hangs, s.
_HANG_SECONDS = 20.0


def _brought_back(place: Place, trap: Trap) -> float:
    """Let a trap end a process; expect that the run goes on by itself and nothing is different."""
    plant = Plant(place.folder / "plant", [trap])
    with ObservedRun(LINES, place.folder, plant=plant) as run:
        run.wait(lambda: plant.sprung > 0, "the trap snapped")
        seconds = seconds_until_back(run)
        expect_end(run, 0)
        expect_identical(place, run)
        return seconds


def resumed(place: Place, lines: Sequence[str] = LINES) -> float:
    """Resume the run whose driver was just killed; expect that nothing is different."""
    started = time.monotonic()
    with ObservedRun(lines, place.folder, "--resume") as run:
        run.wait(lambda: states_of(run) <= {"running", "done"}, "the resumed run at work")
        seconds = time.monotonic() - started
        expect_end(run, 0)
        expect_identical(place, run, *(line.split()[0] for line in lines))
        return seconds


def _killed(title: str) -> Callable[[Place], float]:
    def bring_about(place: Place) -> float:
        with ObservedRun(LINES, place.folder) as run:
            run.wait_for_frames("victim", int(place.random.integers(8, FRAMES - 16)))
            time.sleep(place.random.uniform(0, 0.5))
            run.signal_actor(title, signal.SIGKILL, int(place.random.integers(8)))
            seconds = seconds_until_back(run)
            expect_end(run, 0)
            expect_identical(place, run)
            return seconds

    return bring_about


def _lost_while_a_snapshot_is_written(place: Place) -> float:
    kind = str(place.random.choice(["Layer", "Coordinator", "Segmenter"]))
    when: When = "before" if place.random.integers(2) else "after"
    write = "mlbs_actors.state_file:CapturedState.write"
    return _brought_back(place, Trap(write, "die", when=when, process=f"ray::{kind}"))


def _dies_at_every_start(place: Place) -> None:
    with ObservedRun(LINES, place.folder) as run:
        run.wait_for_frames("victim", 1)
        ended = ("failed", "done", "partial")
        while not all(stream["state"] in ended for stream in run.status().values()):
            for pid in run.processes("ray::SegmenterActor"):
                run.signal_process(pid, signal.SIGKILL)
            time.sleep(0.2)
        words = expect_end(run, 1)
        expect("segmenter" in words, f"the error does not name the part: {words}")
        for name in ("victim", "beside"):
            kept, whole = content(run.output / name)["masks"], place.expected[name]["masks"]
            expect(kept.items() <= whole.items(), f"{name}: what was kept is not as without the fault")


def _hangs(place: Place) -> float:
    sooner = Trap("orchestrator.recovery:STALL_SECONDS", "set", value=_HANG_SECONDS)
    with ObservedRun(LINES, place.folder, plant=Plant(place.folder / "plant", [sooner])) as run:
        run.wait_for_frames("victim", int(place.random.integers(8, FRAMES - 16)))
        run.signal_actor("ray::LayerActor.", signal.SIGSTOP, int(place.random.integers(8)))
        seconds = seconds_until_back(run)
        expect_end(run, 0)
        expect_identical(place, run)
        return seconds


def _decoding_aborts(place: Place) -> None:
    """A file whose decoding aborts the process, every time at the same frame, next to seven good streams."""
    lines = [f"good{seed} 'synthetic:demo?frames=20&width=96&height=72&seed={seed}'" for seed in range(_GOOD)]
    with ObservedRun(lines, place.folder / "without") as run:
        expect_end(run, 0)
        expected = {f"good{seed}": content(run.output / f"good{seed}") for seed in range(_GOOD)}
    made = scene("demo", frames=20, width=96, height=72)
    write_video(place.folder / "aborts.mkv", [made.frame(t) for t in range(20)])
    frame = int(place.random.integers(3, 20))
    abort = Trap("orchestrator.sources.video:VideoReader.read", "abort", frame, times=100)
    position = int(place.random.integers(_GOOD + 1))
    lines.insert(position, f"aborts {place.folder / 'aborts.mkv'}")
    with ObservedRun(lines, place.folder, plant=Plant(place.folder / "plant", [abort])) as run:
        words = expect_end(run, 1)
        aborted = run.status()["aborts"]
        # The frame before may have been on its way out of the process.
        whole_enough = aborted["state"] == "partial" and frame - 1 <= aborted["committed"] <= frame
        expect(whole_enough, f"it is told as {aborted}")
        expect(f"died after {aborted['committed']} frames" in words, f"the error is not told: {words}")
        for name, whole in expected.items():
            expect(content(run.output / name) == whole, f"{name} is not as without the fault")
            expect(run.status()[name]["returns"] == 0, f"{name} was disturbed")


def driver_killed(place: Place, lines: Sequence[str] = LINES) -> float:
    """Kill the command at any time, and resume the run at once."""
    with ObservedRun(lines, place.folder) as run:
        run.wait_for_frames("victim", int(place.random.integers(1, FRAMES - 8)))
        time.sleep(place.random.uniform(0, 0.5))
        run.signal_driver(signal.SIGKILL)
        run.end(killed=True)
        seconds = resumed(place, lines)
        run.expect_clean()
        return seconds


def _driver_killed_and_files_damaged(place: Place) -> float:
    with ObservedRun(LINES, place.folder) as run:
        run.wait(lambda: bool([*run.output.glob("victim/snapshots/*/*/parts")]), "a snapshot")
        run.signal_driver(signal.SIGKILL)
        run.end(killed=True)
        run.expect_clean()  # or its processes would write among what is damaged
        _damage_files(run.output)
        return resumed(place)


def _damage_files(output: Path) -> None:
    """A torn last line; of the snapshots the newest is damaged, the others are joined by a planted pickle."""
    with (output / "victim/commits.jsonl").open("a", encoding="utf-8") as lines:
        lines.write('{"generation": 0, "first": 6')
    newest = sorted(output.glob("*/snapshots/*/*/parts"))[-1].with_name("coordinator")
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    planted = output / "victim/snapshots/9/00000001"
    planted.mkdir(parents=True)
    (planted / "parts").write_bytes(pickle.dumps(Path("/tmp")))


def _interrupted(signals: int) -> Callable[[Place], float]:
    def bring_about(place: Place) -> float:
        number = signal.SIGINT if place.random.integers(2) else signal.SIGTERM
        with ObservedRun(LINES, place.folder) as run:
            run.wait_for_frames("victim", int(place.random.integers(1, FRAMES - 24)))
            for _ in range(signals):
                run.signal_driver(number)
                time.sleep(0.1)
            expect_end(run, 128 + number)
        return resumed(place)

    return bring_about


def _two_runs_on_one_folder(place: Place) -> None:
    with ObservedRun(LINES, place.folder) as first:
        first.wait_for_frames("victim", int(place.random.integers(1, FRAMES // 2)))
        for flags in ((), ("--resume",)):
            with ObservedRun(LINES, place.folder, *flags) as second:
                expect_end(second, 2)
        expect_end(first, 0)
        expect_identical(place, first)


FAULTS = (
    Fault("12", "reader killed", _killed("ray::ReaderActor")),
    Fault("12", f"decoding aborts the process, beside {_GOOD} others", _decoding_aborts),
    Fault("13", "layer killed", _killed("ray::LayerActor")),
    Fault("13", "pool killed", _killed("ray::PoolActor")),
    Fault("13", "sink killed", _killed("ray::SinkActor")),
    Fault("14", "layer killed while a snapshot is written", _lost_while_a_snapshot_is_written),
    Fault("15", "coordinator killed", _killed("ray::CoordinatorActor")),
    Fault("15", "segmenter killed", _killed("ray::SegmenterActor")),
    Fault("16", "segmenter dies at every start", _dies_at_every_start),
    Fault("17", f"layer hangs ({_HANG_SECONDS:.0f} s of patience)", _hangs),
    Fault("19", "driver killed, then --resume", driver_killed),
    Fault("20", "a signal, then --resume", _interrupted(1)),
    Fault("20", "a second signal, then --resume", _interrupted(2)),
    Fault("21", "two runs on one folder", _two_runs_on_one_folder),
    Fault("27", "driver killed, files damaged, then --resume", _driver_killed_and_files_damaged),
)
