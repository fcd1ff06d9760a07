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
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmark.through_ray.process_costs import Process
from chaos import command
from chaos.endurance.soak import Sample, SoakFigures, growth
from chaos.harness.camera import RATE, Camera, as_received, play
from chaos.harness.injection import Injection, Injector
from chaos.harness.observed_run import ExpectationError, content, expect, still_running
from chaos.harness.reference import References
from chaos.harness.scenario import (
    Fault,
    RecoveryTime,
    Scenario,
    ScenarioContext,
    Verdicts,
    first_frames,
    single_fault,
)
from chaos.scenarios.catalogue import FAULTS
from chaos.scenarios.kills import COMMIT_STEPS, KILLS, STEPS
from mlbs_actors.messages import Segmentation
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.live import LiveReader


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
    with pytest.raises(ExpectationError, match="39 masks for 40"):
        content(tmp_path / "a")
    mask.write_bytes(kept)
    log = tmp_path / "a/commits.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    for damaged in (lines[:1], lines[1:]):
        log.write_text("".join(damaged))
        with pytest.raises(ExpectationError, match="committed frames"):
            content(tmp_path / "a")
    log.write_text("".join(lines))
    (tmp_path / "a/frames-00000064.parquet").write_bytes(
        (tmp_path / "a/frames-00000032.parquet").read_bytes()
    )
    with pytest.raises(ExpectationError, match="committed frames"):
        content(tmp_path / "a")
    assert [json.loads(line)["last"] for line in lines] == [7, 31, 39]


def test_what_is_committed_is_compared_without_what_may_yet_change(tmp_path: Path) -> None:
    write(tmp_path / "a", 40)
    whole = content(tmp_path / "a", committed=True)
    assert whole == content(tmp_path / "a")
    log = tmp_path / "a/commits.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    provisional = lines[-1].replace("}", ', "provisional": true}')
    for ends in ([], [provisional]):
        log.write_text("".join(lines[:-1] + ends))
        begun = content(tmp_path / "a", committed=True)
        assert begun == first_frames(whole, 32)
        assert (len(begun["masks"]), len(begun["frames"])) == (32, 32)


def test_a_run_s_processes_are_known_again_under_other_titles_and_others_are_not_taken_for_them() -> None:
    seen = {pid: Process(pid, 1, "ray::IDLE", 0.0, started=500 + pid) for pid in (2, 3, 4, 5)}
    now = {
        2: Process(2, 1, "ray::SinkActor", 3.0, started=502),
        3: Process(3, 1, "ray::IDLE", 0.0, started=900),  # the number was given again
        4: Process(4, 1, "", 0.0, started=504),  # has ended, and waits for its parent
        6: Process(6, 1, "ray::IDLE", 0.0, started=506),
    }
    assert still_running(seen, now) == {2: "ray::SinkActor"}


def test_the_table_says_which_seeds_were_held_and_why_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def held(context: ScenarioContext) -> RecoveryTime:
        return RecoveryTime(float(context.random.uniform(1, 2)), 3.0)

    def not_always(context: ScenarioContext, verdicts: Verdicts) -> None:
        for name in ("two", "three", "four"):
            with verdicts.check(name) as verdict:
                verdict.recovery = RecoveryTime(1.0)
                if name == "two" and context.folder.name.endswith("2"):
                    raise ExpectationError("a frame is missing")
        with verdicts.check("three"):
            expect(not context.folder.name.endswith("3"), "in the end a frame is missing")
        with verdicts.check("two"):
            raise ExpectationError("all is lost")

    faults = tuple(Fault(number, name) for number, name in (("2 3", "two"), ("4", "three"), ("5", "never")))
    series = Scenario("a series", faults, not_always)
    monkeypatch.setattr(command, "FAULTS", (single_fault("1", "one", held), series))
    assert command.main([], tmp_path) == 1
    table, reported = capsys.readouterr()
    assert "three: held, back after 1.0 s\n" in reported
    rows = [row.split() for row in table.splitlines()]
    assert rows[1][:3] == ["1", "one", "3/3"]
    assert rows[1][-2:] == ["3.0–3.0", "s"]
    assert rows[2] == ["2", "3", "two", "0/3", "1.0–1.0", "s"]
    assert [" ".join(row[2:]) for row in rows[3:6]] == ["all is lost", "a frame is missing", "all is lost"]
    assert rows[6][:3] == ["4", "three", "2/3"]
    assert " ".join(rows[7]) == "seed 3: in the end a frame is missing"
    assert rows[8] == ["5", "never", "0/3"]
    assert " ".join(rows[9]) == "seed 1: it was not brought about"
    assert command.main(["--faults", "1,9"], tmp_path) == 0
    assert command.main(["--faults", "9"], tmp_path) == 2
    capsys.readouterr()
    assert command.main(["--only", "three", "--seeds", "2"], tmp_path) == 0
    assert [row.split()[:3] for row in capsys.readouterr().out.splitlines()[1:]] == [["4", "three", "2/2"]]


def test_every_fault_of_the_list_is_brought_about_and_each_has_one_row() -> None:
    faults = [fault for scenario in FAULTS for fault in scenario.faults]
    assert {int(number) for fault in faults for number in fault.number.split()} == set(range(1, 31))
    kills = [fault for scenario in KILLS for fault in scenario.faults]
    assert len(kills) == 2 * len(STEPS) + 2 * len(COMMIT_STEPS) + 4
    for rows in (faults, kills):
        assert len({fault.name for fault in rows}) == len(rows)


def test_kills_are_at_functions_that_there_are() -> None:
    for step in (*STEPS, *COMMIT_STEPS):
        module, _, name = step.function.partition(":")
        assert callable(functools.reduce(getattr, name.split("."), importlib.import_module(module)))


def test_a_reference_is_what_a_run_records(tmp_path: Path) -> None:
    """Also with a picture that cannot be decoded; each is made once."""
    made = scene("demo", frames=8, width=96, height=72)
    (tmp_path / "yard").mkdir()
    for t in range(8):
        cv2.imwrite(str(tmp_path / f"yard/{t}.png"), made.frame(t))
    (tmp_path / "yard/3.png").write_bytes(b"no picture")
    references = References(tmp_path / "references")
    record = references.of("yard yard/", tmp_path)
    assert [row["status"] for row in record["frames"]] == [*["ok"] * 3, "quarantined", *["ok"] * 4]
    assert sorted(record["masks"]) == [f"{t}.png" for t in range(8) if t != 3]
    assert record["layers"]
    assert references.of("yard 'yard/'", tmp_path) is record


# Injections


PART = """
import sys
LIMIT = 60.0
class Part:
    def work(self, number):
        return number
    async def later(self, number):
        return number
"""


def in_process(folder: Path, code: str, *injections: Injection) -> subprocess.CompletedProcess[str]:
    """Run code over a module ``steps`` with injections in it."""
    (folder / "steps.py").write_text(PART)
    injector = Injector(folder / "injector", injections)
    injector.set_driver(-1)
    return subprocess.run(
        [sys.executable, "-c", f"import asyncio, steps\npart = steps.Part()\n{code}"],
        env=_environment(folder),
        capture_output=True,
        text=True,
        check=False,
    )


def test_an_injection_kills_its_process_at_one_call_and_once_in_a_run(tmp_path: Path) -> None:
    code = "for number in range(4): print(part.work(number), flush=True)"
    killed = in_process(tmp_path, code, Injection("steps:Part.work", "die", 2))
    assert (killed.returncode, killed.stdout.split()) == (-signal.SIGKILL, ["0", "1"])
    again = subprocess.run(
        killed.args, env=_environment(tmp_path), capture_output=True, text=True, check=True
    )
    assert again.stdout.split() == ["0", "1", "2", "3"]


def test_an_injection_counts_calls_from_when_it_is_armed_and_not_once_it_is_disarmed(tmp_path: Path) -> None:
    injections = [Injection("steps:Part.work", "fail", 1, value=errno.ENOSPC, armed=False)]
    code = (
        f"from pathlib import Path; armed = Path({str(tmp_path)!r}) / 'injector/armed-0'\n"
        "for number in range(6):\n"
        "    armed.touch() if number == 1 else armed.unlink() if number == 4 else None\n"
        "    try: print(part.work(number))\n"
        "    except OSError: print('failed')"
    )
    assert in_process(tmp_path, code, *injections).stdout.split() == ["0", "1", "failed", "failed", "4", "5"]
    injector = Injector(tmp_path / "other", injections)
    assert not [*(tmp_path / "other").glob("armed-*")]
    injector.arm(injections[0])
    assert [path.name for path in (tmp_path / "other").glob("armed-*")] == ["armed-0"]
    injector.disarm(injections[0])
    assert not injector.has_fired(injections[0])


def test_an_injection_records_when_each_object_first_calls_it(tmp_path: Path) -> None:
    injection = Injection("steps:Part.work", "record", when="after")
    before = time.monotonic()
    code = "for number in range(6):\n    vars(part).clear() if number == 3 else None\n    part.work(number)"
    ended = in_process(tmp_path, code, injection)
    subprocess.run(ended.args, env=_environment(tmp_path), check=True)
    times = Injector(tmp_path / "another", [injection]).recorded_times(injection)
    assert times == []
    notes = sorted(float(note.read_text()) for note in (tmp_path / "injector").glob("recorded-0-*"))
    assert len(notes) == 4  # two in each process
    assert before < notes[0] < notes[1] < notes[2] < notes[3] < time.monotonic()


def test_an_injection_fires_only_in_processes_of_its_kind(tmp_path: Path) -> None:
    ended = in_process(tmp_path, "part.work(0)", Injection("steps:Part.work", "die", process="ray::Sink"))
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
        Injection("steps:Part.work", "fail", 1, value=errno.ENOSPC),
        Injection("steps:Part.later", "wait", value=0.01),
        Injection("steps:LIMIT", "set", value=5),
    )
    assert ended.stdout.splitlines() == ["5.0 7 0", *["No space left on device"] * 2], ended.stderr
    assert len([*(tmp_path / "injector").glob("fired-*")]) == 2


def test_after_its_return_a_call_takes_the_driver_with_it(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as driver:
        code = f"open({str(tmp_path / 'injector/driver')!r}, 'w').write('{driver.pid}'); part.work(0)"
        ended = in_process(tmp_path, code, Injection("steps:Part.work", "kill driver", when="after"))
        assert (ended.returncode, driver.wait()) == (-signal.SIGKILL, -signal.SIGKILL)


def _environment(folder: Path) -> dict[str, str]:
    paths = (folder / "injector", folder)
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
        deadline = time.monotonic() + 180
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


def samples(sizes: list[float], running: str) -> list[Sample]:
    return [
        Sample(number, 100 * number, frozenset(running), {"sink": size, "layer": 50.0}, 9, 4, 100)
        for number, size in enumerate(sizes)
    ]


def test_growth_is_told_over_stretches_with_the_same_streams_at_work() -> None:
    rising = samples([100 + 0.3 * number for number in range(8)], "ab")
    ended = samples([20 + 0.3 * number for number in range(8)], "b")
    assert growth([*rising, *ended], ["sink"]) == pytest.approx(3.0)
    assert growth([*rising, *ended], ["layer"]) == pytest.approx(0.0)
    assert np.isnan(growth(samples([1.0] * 9, ""), ["sink"]))
    # A process more is no growth of the others.
    more = [replace(look, processes=10, memory={"sink": 2 * look.memory["sink"]}) for look in rising[4:]]
    assert growth([*rising[:4], *more], ["sink"]) == pytest.approx(4.5)
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
@pytest.mark.parametrize("fault", ["18", "29", "30"])
def test_a_run_survives_a_lost_and_an_unusable_node_and_a_receiver_that_is_away(
    tmp_path: Path, fault: str
) -> None:
    assert command.main(["--faults", fault, "--seeds", "1"], tmp_path) == 0
