"""The faults: each is brought about in a run, whose output and processes tell whether it was held.

Held means: the run ends by itself with the right exit status and state; every decoded frame has one label
map, in order; the label maps and rows are those of an undisturbed run, also those of the stream beside it; no
process is left. The time until work goes on is measured.
"""

from __future__ import annotations

import pickle
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.chaos.observed_run import ObservedRun, content, expect
from orchestrator.sources.synthetic import scene

__all__ = ["FAULTS", "FRAMES", "Fault", "Place", "undisturbed"]

#: Length of the streams that faults are brought into.
FRAMES = 100

_LINES = [
    f"victim 'synthetic:demo?frames={FRAMES}&width=160&height=120'",
    f"beside 'synthetic:pan?frames={FRAMES}&width=160&height=120'",
]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fault is brought about.

    Attributes
    ----------
    folder : Path
        For the run's files.
    expected : dict
        Content of the undisturbed streams, by name.
    random : numpy Generator
        Of this fault and seed.
    """

    folder: Path
    expected: dict[str, Any]
    random: np.random.Generator


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the list of those that must be survived.

    Attributes
    ----------
    number : str
        In that list.
    name : str
    bring_about : callable
        Raises NotHeldError; returns the seconds until work went on, if that has a meaning.
    """

    number: str
    name: str
    bring_about: Callable[[Place], float | None]


def undisturbed(folder: Path) -> dict[str, Any]:
    """Run the streams with nothing going wrong; return what they must always give."""
    with ObservedRun(_LINES, folder) as run:
        status, words = run.end()
        expect(status == 0, f"the undisturbed run ended with status {status}: {words}")
        return {name: content(run.output / name) for name in ("victim", "beside")}


def _expect_identical(place: Place, run: ObservedRun, *names: str) -> None:
    for name in names or ("victim", "beside"):
        expect(content(run.output / name) == place.expected[name], f"{name} is not as without the fault")


def _expect_end(run: ObservedRun, status: int) -> str:
    ended, words = run.end()
    expect(ended == status, f"exit status {ended} instead of {status}: {words}")
    expect("Traceback" not in words, f"a traceback: {words}")
    return words


def _seconds_until_back(run: ObservedRun, stream: str) -> float:
    """Wait until a stream that has just lost something is at work again."""
    started = time.monotonic()

    def back() -> bool:
        state = run.status()[stream]
        return state["returns"] > 0 and state["state"] in ("running", "done")

    run.wait(back, f"{stream} back at work")
    return time.monotonic() - started


def _actor_lost(title: str, stop: signal.Signals = signal.SIGKILL) -> Callable[[Place], float]:
    def bring_about(place: Place) -> float:
        with ObservedRun(_LINES, place.folder) as run:
            run.wait_for_frames("victim", int(place.random.integers(8, FRAMES - 16)))
            time.sleep(place.random.uniform(0, 0.5))
            run.signal_actor(title, stop, int(place.random.integers(8)))
            names = ("victim", "beside")
            run.wait(lambda: any(run.status()[name]["returns"] for name in names), "the loss noticed")
            hit = next(name for name in names if run.status()[name]["returns"])
            seconds = _seconds_until_back(run, hit)
            _expect_end(run, 0)
            _expect_identical(place, run)
            return seconds

    return bring_about


def _lost_while_a_snapshot_is_written(place: Place) -> float:
    with ObservedRun(_LINES, place.folder) as run:
        run.wait(lambda: bool([*run.output.glob("victim/snapshots/*/*")]), "a snapshot begun")
        run.signal_actor("ray::LayerActor", signal.SIGKILL, int(place.random.integers(8)))
        _expect_end(run, 0)
        _expect_identical(place, run)
    return 0.0


def _dies_at_every_start(place: Place) -> None:
    with ObservedRun(_LINES, place.folder) as run:
        run.wait_for_frames("victim", 1)
        ended = ("failed", "done", "partial")
        while not all(stream["state"] in ended for stream in run.status().values()):
            for pid in run.processes("ray::SegmenterActor"):
                run.signal_process(pid, signal.SIGKILL)
            time.sleep(0.2)
        words = _expect_end(run, 1)
        expect("segmenter" in words, f"the error does not name the part: {words}")
        for name in ("victim", "beside"):
            kept, whole = content(run.output / name)["masks"], place.expected[name]["masks"]
            expect(kept.items() <= whole.items(), f"{name}: what was kept is not as without the fault")


def _driver_killed(
    after: int = 1, damage: Callable[[Path], None] = lambda output: None
) -> Callable[[Place], float]:
    def bring_about(place: Place) -> float:
        with ObservedRun(_LINES, place.folder) as first:
            first.wait_for_frames("victim", int(place.random.integers(after, FRAMES - 8)))
            time.sleep(place.random.uniform(0, 0.5))
            first.signal_driver(signal.SIGKILL)
            first.end(killed=True)
            damage(first.output)
            started = time.monotonic()
            with ObservedRun(_LINES, place.folder, "--resume") as second:
                second.wait(lambda: _states(second) <= {"running", "done"}, "the resumed run at work")
                seconds = time.monotonic() - started
                _expect_end(second, 0)
                _expect_identical(place, second)
            first.expect_clean()
            return seconds

    return bring_about


def _states(run: ObservedRun) -> set[str]:
    """States of the streams; "none" before they are told."""
    return {stream["state"] for stream in run.status().values()} or {"none"}


def _damage_files(output: Path) -> None:
    """A torn last line; of the snapshots the newest is damaged, the others are joined by a planted pickle."""
    log = output / "victim/commits.jsonl"
    if log.exists():
        with log.open("a", encoding="utf-8") as lines:
            lines.write('{"generation": 0, "first": 6')
    listed = sorted(output.glob("*/snapshots/*/*/parts"))
    for parts in listed[-1:]:
        part = parts.with_name("coordinator")
        data = bytearray(part.read_bytes())
        data[len(data) // 2] ^= 1
        part.write_bytes(data)
    planted = output / "victim/snapshots/9/00000001"
    planted.mkdir(parents=True)
    (planted / "parts").write_bytes(pickle.dumps(Path("/tmp")))


def _interrupted(signals: int) -> Callable[[Place], float | None]:
    def bring_about(place: Place) -> float | None:
        number = signal.SIGINT if place.random.integers(2) else signal.SIGTERM
        with ObservedRun(_LINES, place.folder) as first:
            first.wait_for_frames("victim", int(place.random.integers(1, FRAMES - 24)))
            for _ in range(signals):
                first.signal_driver(number)
                time.sleep(0.1)
            _expect_end(first, 128 + number)
        with ObservedRun(_LINES, place.folder, "--resume") as second:
            _expect_end(second, 0)
            _expect_identical(place, second)
        return None

    return bring_about


def _two_runs_on_one_folder(place: Place) -> None:
    with ObservedRun(_LINES, place.folder) as first:
        first.wait_for_frames("victim", int(place.random.integers(1, FRAMES // 2)))
        for flags in ((), ("--resume",)):
            with ObservedRun(_LINES, place.folder, *flags) as second:
                _expect_end(second, 2)
        _expect_end(first, 0)
        _expect_identical(place, first)


def _folder_gone(place: Place) -> None:
    with ObservedRun(_LINES, place.folder) as run:
        run.wait_for_frames("victim", int(place.random.integers(1, FRAMES // 2)))
        (run.output / "victim").rename(run.output / "elsewhere")
        words = _expect_end(run, 1)
        expect("victim" in words and "cannot be written" in words, f"the error is not told: {words}")
        _expect_identical(place, run, "beside")


def _bad_sources(place: Place) -> None:
    place.folder.mkdir()
    (place.folder / "text.mp4").write_text("no video")
    (place.folder / "empty").mkdir()
    bad = ["missing none.mp4", "text text.mp4", "empty empty/"]
    with ObservedRun([*bad, *_LINES], place.folder) as run:
        _expect_end(run, 1)
        states = {name: stream["state"] for name, stream in run.status().items()}
        expect(
            states
            == dict.fromkeys(("missing", "text", "empty"), "failed") | dict.fromkeys(place.expected, "done"),
            f"the states are {states}",
        )
        _expect_identical(place, run)


def _odd_pictures(place: Place) -> None:
    """An undecodable picture, black, white and constant ones, grey, 16 bits, alpha, odd sizes, one row."""
    made = scene("demo", frames=8, width=97, height=73)
    colours = [made.frame(t) for t in range(8)]
    grey = [cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in colours]
    kinds: dict[str, list[Array]] = {
        "grey": grey,
        "deep": [one.astype(np.uint16) * 257 for one in grey],
        "alpha": [cv2.cvtColor(one, cv2.COLOR_BGR2BGRA) for one in colours],
        "row": [one[:1] for one in colours],
        "black": [np.zeros_like(one) for one in colours],
        "white": [np.full_like(one, 255) for one in colours],
        "frozen": [colours[0]] * 8,
        "damaged": colours,
    }
    for name, pictures in kinds.items():
        (place.folder / name).mkdir(parents=True)
        for index, picture in enumerate(pictures):
            cv2.imwrite(str(place.folder / name / f"{index}.png"), picture)
    (place.folder / "damaged" / f"{place.random.integers(8)}.png").write_bytes(b"\x89PNG damaged")
    with ObservedRun([f"{name} {name}/" for name in kinds], place.folder) as run:
        _expect_end(run, 1)
        for name in kinds:
            expected = ("partial", 7) if name == "damaged" else ("done", 8)
            state = run.status()[name]
            expect((state["state"], state["committed"]) == expected, f"{name}: {state}")
            content(run.output / name)


def _hostile_list(place: Place) -> None:
    lines = ["../up a.mp4", "concat:a|b", "x http://user:hunter2@host/y"]
    lines += ["twin a.mp4", "twin b.mp4", "nul\0 a.mp4"]
    with ObservedRun(lines, place.folder) as run:
        words = _expect_end(run, 2)
        expect(not run.output.exists(), "there is output")
        expect("hunter2" not in words, "a password is told")
        for number in (1, 2, 3, 5, 6):
            expect(f"line {number}:" in words, f"line {number} is not refused: {words}")


#: All that are brought about here, in the order of their numbers.
FAULTS = (
    Fault("1", "sources that are missing, empty, no video", _bad_sources),
    Fault("6 8 10", "odd and undecodable pictures", _odd_pictures),
    Fault("12", "reader killed", _actor_lost("ray::ReaderActor")),
    Fault("13", "layer killed", _actor_lost("ray::LayerActor")),
    Fault("13", "pool killed", _actor_lost("ray::PoolActor")),
    Fault("13", "sink killed", _actor_lost("ray::SinkActor")),
    Fault("14", "layer killed while a snapshot is written", _lost_while_a_snapshot_is_written),
    Fault("15", "coordinator killed", _actor_lost("ray::CoordinatorActor")),
    Fault("15", "segmenter killed", _actor_lost("ray::SegmenterActor")),
    Fault("16", "segmenter dies at every start", _dies_at_every_start),
    Fault("17", "layer hangs", _actor_lost("ray::LayerActor", signal.SIGSTOP)),
    Fault("19", "driver killed, then --resume", _driver_killed()),
    Fault("20", "a signal, then --resume", _interrupted(1)),
    Fault("20", "a second signal, then --resume", _interrupted(2)),
    Fault("21", "two runs on one folder", _two_runs_on_one_folder),
    Fault("23", "output folder gone", _folder_gone),
    Fault("27", "driver killed, files damaged, then --resume", _driver_killed(72, _damage_files)),
    Fault("28", "hostile list", _hostile_list),
)
