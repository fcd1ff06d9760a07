"""The files of a run: claimed once, never half written, true, and without credentials."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from orchestrator.command_line import parse
from orchestrator.events.delivery import Backlog
from orchestrator.options import recorded
from orchestrator.run.closing_words import closing_words, what_to_look_at
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_state import StreamState
from orchestrator.sources.address import parse_address
from orchestrator.storage import durable_files
from orchestrator.storage.commit_log import CommitLog
from orchestrator.storage.durable_files import append_line, replace_file


def listed(name: str, uri: str) -> ListedStream:
    return ListedStream(name, parse_address(uri, Path("/videos")), 1)


MASKS = recorded({"save": {"masks"}})
STATES = [
    StreamState("yard", "done", read=12, committed=12),
    StreamState("a<b>", "partial", read=9, committed=8, quarantined=1, error="1 frame <is> bad."),
]


def test_an_unused_folder_is_accepted_and_left_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    RunFolder(tmp_path).refuse_if_used(["yard"])
    RunFolder(tmp_path / "deep/er").refuse_if_used(["yard"])
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(("existing", "words"), [("run.json", "--resume"), ("yard", "'yard' already")])
def test_a_folder_that_holds_a_run_or_a_stream_s_name_is_refused(
    tmp_path: Path, existing: str, words: str
) -> None:
    (tmp_path / existing).touch()
    with pytest.raises(ConfigError, match=words):
        RunFolder(tmp_path).refuse_if_used(["yard"])


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    for path in (tmp_path / "out", tmp_path / "out/deeper"):
        with pytest.raises(ConfigError, match="not a folder"):
            RunFolder(path).refuse_if_used(["yard"])


def test_of_many_runs_that_begin_at_once_in_one_folder_exactly_one_gets_it(tmp_path: Path) -> None:
    outcomes: list[int | None] = []
    barrier = threading.Barrier(8)

    def begin(number: int) -> None:
        barrier.wait()
        try:
            RunFolder(tmp_path).create({"number": number})
            outcomes.append(number)
        except ConfigError:
            outcomes.append(None)

    threads = [threading.Thread(target=begin, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(outcome is not None for outcome in outcomes) == 1
    json.loads((tmp_path / "run.json").read_text())


def test_a_second_run_is_refused_and_the_first_one_keeps_its_description(tmp_path: Path) -> None:
    RunFolder(tmp_path).create({"number": 1})
    with pytest.raises(ConfigError, match="Another run"):
        RunFolder(tmp_path).create({"number": 2})
    assert json.loads((tmp_path / "run.json").read_text()) == {"number": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_a_run_is_described_by_all_that_its_results_depend_on_but_no_password() -> None:
    streams = [listed("yard", "yard.mp4"), listed("door", "rtsp://bob:hunter2@cam/door?token=hunter3")]
    description = describe_run(streams, Config(), recorded({"save": {"parquet", "masks"}, "max_frames": 7}))
    assert description["sources"] == {"yard": "/videos/yard.mp4", "door": "rtsp://***@cam/door?token=***"}
    assert description["config"] == Config().model_dump(mode="json")
    assert (description["save"], description["max_frames"]) == (["masks", "parquet"], 7)
    assert description["versions"]["numpy"]
    assert "hunter" not in json.dumps(description)


def test_the_hashes_change_with_the_configuration_and_the_sources_only() -> None:
    def hashes(config: Config, uri: str) -> dict[str, str]:
        described: dict[str, str] = describe_run([listed("a", uri)], config, MASKS)["hashes"]
        return described

    other = Config.model_validate({"layers": {"lookahead": 3}})
    first = hashes(Config(), "a.mp4")
    assert hashes(Config(), "a.mp4") == first
    assert hashes(other, "a.mp4")["config"] != first["config"]
    assert hashes(other, "a.mp4")["sources"] == first["sources"]
    assert hashes(Config(), "b.mp4")["sources"] != first["sources"]


def test_the_status_file_says_how_each_stream_stands(tmp_path: Path) -> None:
    backlog = Backlog("mqtt://broker/***", 3, 1.75e9)
    status = StatusFile(tmp_path / "status.json", backlogs=lambda: [backlog])
    status.update([StreamState("yard", "running", read=9, committed=4), StreamState("door")])
    written = json.loads((tmp_path / "status.json").read_text())
    assert (written["ended"], written["running"], written["waiting"]) == (False, 1, 1)
    assert written["events"] == [
        {"target": "mqtt://broker/***", "waiting": 3, "away_since": "2025-06-15T15:06:40+00:00", "refused": 0}
    ]
    status.finish(STATES, 1)
    written = json.loads((tmp_path / "status.json").read_text())
    assert (written["ended"], written["exit_status"]) == (True, 1)
    assert written["streams"]["a<b>"] == {
        "state": "partial",
        "read": 9,
        "committed": 8,
        "dropped": 0,
        "quarantined": 1,
        "gaps": 0,
        "layers": 0,
        "frames_per_second": 0.0,
        "latency_ms": 0.0,
        "error": "1 frame <is> bad.",
        "line": None,
        "returns": 0,
        "interrupted": False,
        "length": None,
        "without_process": 0,
        "objects": 0,
        "live": False,
        "cores": 0.0,
        "earlier_cores": 0.0,
        "memory": 0,
        "queued": 0,
        "seconds_left": None,
        "node": None,
        "waits_for": None,
    }


def test_the_status_file_is_not_written_more_often_than_twice_a_second(tmp_path: Path) -> None:
    now = [0.0]
    status = StatusFile(tmp_path / "status.json", lambda: now[0])
    writings = []
    for read in range(100):
        now[0] = read * 0.1
        status.update([StreamState("yard", "running", read=read)])
        writings.append((tmp_path / "status.json").read_text())
    assert len(set(writings)) == 20


def test_a_run_that_is_told_to_end_says_so_at_once_as_it_may_be_killed_before_its_end(tmp_path: Path) -> None:
    now = [0.0]
    status = StatusFile(tmp_path / "status.json", lambda: now[0])

    def written() -> tuple[bool, object, bool]:
        figures = json.loads((tmp_path / "status.json").read_text())
        return figures["ended"], figures["exit_status"], figures["alive_until"] is not None

    status.update(STATES)
    assert written() == (False, None, True)
    status.stopping = lambda: True
    status.update(STATES)  # in the same half second
    assert written() == (True, None, True)
    (tmp_path / "status.json").write_text("{}")
    status.update(STATES)  # once only
    assert (tmp_path / "status.json").read_text() == "{}"
    status.finish(STATES, 143)
    assert written() == (True, 143, False)


def test_a_status_that_cannot_be_written_stops_nothing_while_running_but_is_told_at_the_end(
    tmp_path: Path,
) -> None:
    status = StatusFile(tmp_path / "gone/status.json")
    status.update(STATES)
    with pytest.raises(FileNotFoundError):
        status.finish(STATES, 0)


def test_a_reader_never_sees_a_half_written_file(tmp_path: Path) -> None:
    path, contents = tmp_path / "a.json", [bytes([65 + number]) * 100_000 for number in range(8)]
    replace_file(path, contents[0])
    stop, seen = threading.Event(), set()

    def watch() -> None:
        while not stop.is_set():
            seen.add(path.read_bytes())

    watcher = threading.Thread(target=watch)
    watcher.start()
    for content in contents:
        replace_file(path, content)
    stop.set()
    watcher.join()
    assert seen
    assert seen <= set(contents)


def test_a_failed_replacement_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_file(tmp_path / "a", b"old")

    def fail(path: Path) -> None:
        raise OSError(5, "I/O error")

    monkeypatch.setattr(durable_files, "_sync", fail)
    with pytest.raises(OSError, match="I/O"):
        replace_file(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"old"


def test_lines_are_appended_whole_and_in_order(tmp_path: Path) -> None:
    for number in range(3):
        append_line(tmp_path / "log", str(number))
    assert (tmp_path / "log").read_text() == "0\n1\n2\n"


# Going on


def record_frame(folder: Path) -> None:
    folder.mkdir()
    log = CommitLog(folder)
    with log.exclusive():
        log.add(0, None, provisional=False)


def test_lines_of_the_list_may_change_whose_streams_have_no_frame_yet(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)

    def described(**sources: str) -> dict[str, Any]:
        streams = [listed(name, source) for name, source in sources.items()]
        return describe_run(streams, Config(), MASKS)

    folder.create(described(yard="yard.mp4", door="dor.mp4"))
    record_frame(tmp_path / "yard")
    for allowed in (
        described(yard="yard.mp4", door="door.mp4"),
        described(gate="gate.mp4", yard="yard.mp4"),
        described(yard="yard.mp4"),
    ):
        folder.refuse_other(folder.description(), allowed)
    for refused in (described(yard="other.mp4", door="dor.mp4"), described(door="dor.mp4")):
        with pytest.raises(ConfigError, match="had other streams"):
            folder.refuse_other(folder.description(), refused)


def test_a_run_is_gone_on_with_only_as_it_was_begun(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    streams, config = [listed("yard", "yard.mp4")], Config()
    plain = describe_run(streams, config, MASKS)
    assert not folder.holds_run
    folder.create(plain)
    assert folder.holds_run
    record_frame(tmp_path / "yard")
    begun = folder.description()
    folder.refuse_other(begun, plain | {"started": "later"})
    other_config = Config.model_validate({"layers": {"lookahead": 1}})
    ignoring = MASKS | {"ignore": {"yard=/mask.png": "ab12"}}
    for description, words in (
        (describe_run(streams, other_config, MASKS), r"parameters \(layers.lookahead was 0, now 1\)"),
        (describe_run([listed("yard", "other.mp4")], config, MASKS), "streams"),
        (
            describe_run(streams, config, recorded({"save": {"parquet"}})),
            r"--save \(was masks, now parquet\)",
        ),
        (
            describe_run(streams, config, MASKS | {"max_frames": 7}),
            r"--max-frames \(was not given, now 7\)",
        ),
        (describe_run(streams, config, MASKS | {"max_side": 64}), "--max-side"),
        (
            describe_run(streams, config, ignoring),
            r"--ignore \(was not given, now yard=/mask.png\)",
        ),
    ):
        with pytest.raises(ConfigError, match=f"had other .*{words}"):
            folder.refuse_other(begun, description)
    folder.refuse_other(begun | {"zones": "cd34"}, plain | {"zones": "ab12"})  # zones may be moved
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ConfigError, match="cannot be read"):
        folder.description()


def test_the_states_of_the_streams_are_read_back_from_the_status(tmp_path: Path) -> None:
    states = [
        *STATES,
        StreamState("cut", "partial", error="Interrupted.", interrupted=True),
        StreamState("killed", "running", read=8),
        StreamState("gone", "failed", error="No such file."),
    ]
    assert RunFolder(tmp_path).states() == {}
    StatusFile(tmp_path / "status.json").finish(states, 1)
    assert RunFolder(tmp_path).states() == {state.name: state for state in states}


def test_one_run_at_a_time_has_a_folder_and_a_killed_one_keeps_nobody_out(tmp_path: Path) -> None:
    code = (
        "import pathlib, sys; from orchestrator.run.run_folder import RunFolder\n"
        f"with RunFolder(pathlib.Path({str(tmp_path)!r})).locked():\n"
        "    print('held', flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ConfigError, match="Another run is at work"), RunFolder(tmp_path).locked():
            pass
        other.kill()
    with RunFolder(tmp_path).locked():
        pass


def test_a_user_is_sent_to_all_videos_of_a_stream_or_to_its_masks(tmp_path: Path) -> None:
    assert what_to_look_at(tmp_path, frozenset({"parquet"})) == str(tmp_path)
    assert what_to_look_at(tmp_path, frozenset({"masks"})) == str(tmp_path / "masks")
    (tmp_path / "overlay.mp4").touch()
    assert what_to_look_at(tmp_path, frozenset({"masks"})) == str(tmp_path / "overlay.mp4")
    (tmp_path / "overlay-00000120.mp4").touch()
    assert what_to_look_at(tmp_path, frozenset({"masks"})) == f"{tmp_path / 'overlay*.mp4'} (2 parts)"


def test_a_status_says_until_when_its_run_is_alive_also_when_nothing_changes(tmp_path: Path) -> None:
    now, alive = [0.0], []
    status = StatusFile(tmp_path / "status.json", lambda: now[0])
    for second in range(3):
        now[0] = float(second)
        status.update([StreamState("door")])
        written = json.loads((tmp_path / "status.json").read_text())
        alive.append(written["alive_until"])
        assert datetime.fromisoformat(written["alive_until"]) > datetime.fromisoformat(written["updated"])
    assert sorted(set(alive)) == alive
    status.finish([StreamState("door", "done")], 0)
    assert json.loads((tmp_path / "status.json").read_text())["alive_until"] is None


def test_a_camera_that_never_sent_a_picture_is_told_at_the_end(tmp_path: Path) -> None:
    states = [
        StreamState("gate", "done", read=9, committed=9, live=True),
        StreamState("lane", "done", live=True),
        StreamState("clip", "done"),
    ]
    arguments = parse(["--streams", "list.txt"])
    _, *others = closing_words(RunFolder(tmp_path), states, arguments).splitlines()
    assert [line for line in others if "no picture" in line] == ["  lane: no picture has come from it"]
