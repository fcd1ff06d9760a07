"""The injector of faults: its table tells the truth, and a real run survives a kill."""

from __future__ import annotations

import errno
import functools
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.messages import Segmentation
from orchestrator.chaos import command, kills
from orchestrator.chaos.camera import RATE, Camera, as_received, play
from orchestrator.chaos.faults import FAULTS
from orchestrator.chaos.observed_run import NotHeldError, content
from orchestrator.chaos.place import Fault, Place
from orchestrator.chaos.planted import Plant, Trap
from orchestrator.chaos.soak import Look, SoakFigures, growth
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.live import LiveReader
from orchestrator.sources.synthetic import scene


def write(folder: Path, frames: int) -> None:
    record = StreamRecord(folder, folder.name, frozenset({"masks", "parquet"}))
    empty = np.zeros((8, 8), np.uint8)
    for index in range(frames):
        labels = empty.astype(np.uint16)
        result = Segmentation(index, labels, empty, empty.view(np.int8), (), (0.0, 0.0), 0, {"cut": index})
        record.write(result, SourceFrame(index, None, index / 25, f"{index:05d}"))
    record.close(whole=True)


def test_content_leaves_times_out_and_refuses_what_is_not_complete(tmp_path: Path) -> None:
    write(tmp_path / "a", 40)
    whole = content(tmp_path / "a")
    assert len(whole["masks"]) == len(whole["frames"]) == 40
    assert not any("ms_" in key for row in whole["frames"] for key in row)
    mask = tmp_path / "a/masks/00007.png"
    kept = mask.read_bytes()
    mask.unlink()
    with pytest.raises(NotHeldError, match="39 masks for 40"):
        content(tmp_path / "a")
    mask.write_bytes(kept)
    log = tmp_path / "a/commits.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    for damaged in (lines[:1], lines[1:]):
        log.write_text("".join(damaged))
        with pytest.raises(NotHeldError, match="committed frames"):
            content(tmp_path / "a")
    log.write_text("".join(lines))
    (tmp_path / "a/frames-00000064.parquet").write_bytes(
        (tmp_path / "a/frames-00000032.parquet").read_bytes()
    )
    with pytest.raises(NotHeldError, match="committed frames"):
        content(tmp_path / "a")
    assert [json.loads(line)["last"] for line in lines] == [7, 31, 39]


def test_the_table_says_which_seeds_were_held_and_why_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def held(place: Place) -> float:
        return float(place.random.uniform(1, 2))

    def not_always(place: Place) -> None:
        if place.folder.name.endswith("1"):
            raise NotHeldError("a frame is missing")

    monkeypatch.setattr(command, "FAULTS", (Fault("1", "one", held), Fault("2 3", "two", not_always)))
    assert command.main([], tmp_path) == 1
    rows = capsys.readouterr().out.splitlines()
    assert rows[1].split()[:3] == ["1", "one", "3/3"]
    assert rows[2].split() == ["2", "3", "two", "2/3"]
    assert rows[3].strip() == "seed 1: a frame is missing"
    assert command.main(["--faults", "1,9"], tmp_path) == 0
    assert command.main(["--faults", "9"], tmp_path) == 2


def test_every_fault_of_the_list_is_brought_about() -> None:
    assert {int(number) for fault in FAULTS for number in fault.number.split()} == set(range(1, 29))


def test_kills_are_at_functions_that_there_are() -> None:
    functions = [step[2] for step in kills.STEPS] + [step[1] for step in kills.COMMIT_STEPS]
    for function in functions:
        module, _, name = function.partition(":")
        assert callable(functools.reduce(getattr, name.split("."), importlib.import_module(module)))


# Traps


STEPS = """
import sys
LIMIT = 60.0
class Part:
    def work(self, number):
        return number
    async def later(self, number):
        return number
"""


def in_process(folder: Path, code: str, *traps: Trap) -> subprocess.CompletedProcess[str]:
    """Run code over a module ``steps`` with traps in it."""
    (folder / "steps.py").write_text(STEPS)
    plant = Plant(folder / "plant", traps)
    plant.tell_driver(-1)
    return subprocess.run(
        [sys.executable, "-c", f"import asyncio, steps\npart = steps.Part()\n{code}"],
        env=_environment(folder),
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_trap_kills_its_process_at_one_call_and_once_in_a_run(tmp_path: Path) -> None:
    code = "for number in range(4): print(part.work(number), flush=True)"
    killed = in_process(tmp_path, code, Trap("steps:Part.work", "die", 2))
    assert (killed.returncode, killed.stdout.split()) == (-signal.SIGKILL, ["0", "1"])
    again = subprocess.run(
        killed.args, env=_environment(tmp_path), capture_output=True, text=True, check=True
    )
    assert again.stdout.split() == ["0", "1", "2", "3"]


def test_a_trap_is_sprung_only_in_processes_of_its_kind(tmp_path: Path) -> None:
    ended = in_process(tmp_path, "part.work(0)", Trap("steps:Part.work", "die", process="ray::Sink"))
    assert ended.returncode == 0


def test_a_call_fails_from_one_on_and_a_coroutine_is_awaited_and_a_value_set(tmp_path: Path) -> None:
    code = (
        "print(steps.LIMIT, asyncio.run(part.later(7)), part.work(0))\n"
        "for number in range(2):\n"
        "    try: part.work(1)\n"
        "    except OSError as error: print(error.strerror)"
    )
    ended = in_process(
        tmp_path,
        code,
        Trap("steps:Part.work", "fail", 1, value=errno.ENOSPC),
        Trap("steps:Part.later", "wait", value=0.01),
        Trap("steps:LIMIT", "set", value=5),
    )
    assert ended.stdout.splitlines() == ["5.0 7 0", *["No space left on device"] * 2], ended.stderr
    assert Plant(tmp_path / "other", []).sprung == 0
    assert len([*(tmp_path / "plant").glob("sprung-*")]) == 2


def test_after_its_return_a_call_takes_the_driver_with_it(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as driver:
        code = f"open({str(tmp_path / 'plant/driver')!r}, 'w').write('{driver.pid}'); part.work(0)"
        ended = in_process(tmp_path, code, Trap("steps:Part.work", "kill driver", when="after"))
        assert (ended.returncode, driver.wait()) == (-signal.SIGKILL, -signal.SIGKILL)


def _environment(folder: Path) -> dict[str, str]:
    paths = (folder / "plant", folder, Path(__file__).parents[1])
    return os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}


# The camera


def test_the_camera_sends_what_it_is_told_to_and_refuses_when_it_is_told_to() -> None:
    made = scene("demo", frames=20, width=96, height=72)
    pictures = [made.frame(t) for t in range(20)]

    def script(number: int) -> Iterator[int] | None:
        return None if number == 0 else play(0, 1_000, time.monotonic())

    with Camera(pictures, script) as camera:
        reader = LiveReader.of(parse_address(camera.address, Path("/")))
        frames: list[SourceFrame] = []
        deadline = time.monotonic() + 30
        while sum(frame.image is not None for frame in frames) < 3:
            assert time.monotonic() < deadline
            if isinstance(read := reader.read(), SourceFrame):
                frames.append(read)
        reader.close()
    assert len(camera.connected) >= 2
    received = as_received(pictures, len(frames))
    for frame in frames:
        assert round(frame.pts * RATE) == frame.index
        if frame.image is not None:
            np.testing.assert_array_equal(frame.image, received[frame.index])
    assert np.abs(received[0].astype(int) - pictures[0]).mean() < 6


# The soak


def looks(sizes: list[float], running: str) -> list[Look]:
    return [
        Look(number, 100 * number, frozenset(running), {"sink": size, "layer": 50.0}, 9, 4, 100)
        for number, size in enumerate(sizes)
    ]


def test_growth_is_told_over_stretches_with_the_same_streams_at_work() -> None:
    rising = looks([100 + 0.3 * number for number in range(8)], "ab")
    ended = looks([20 + 0.3 * number for number in range(8)], "b")
    assert growth([*rising, *ended], ["sink"]) == pytest.approx(3.0)
    assert growth([*rising, *ended], ["layer"]) == pytest.approx(0.0)
    assert np.isnan(growth(looks([1.0] * 9, ""), ["sink"]))
    text = SoakFigures((*rising, *ended), 1500, 7).table()
    assert "1500 label maps, 7 objects" in text
    assert "+3.00" in text


# Real runs


def test_a_hostile_list_is_refused(tmp_path: Path) -> None:
    assert command.main(["--faults", "28", "--seeds", "1"], tmp_path) == 0


@pytest.mark.long
@pytest.mark.ray
@pytest.mark.parametrize("words", [["--fast"], ["--faults", "19", "--seeds", "1"]])
def test_a_run_survives_faults(words: list[str], tmp_path: Path) -> None:
    assert command.main(words, tmp_path) == 0


@pytest.mark.long
@pytest.mark.ray
def test_a_node_of_a_cluster_may_go(tmp_path: Path) -> None:
    assert command.main(["--faults", "18", "--seeds", "1"], tmp_path) == 0
