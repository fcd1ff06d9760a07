"""The command as a user meets it: its flags, its refusals, its exit status, whole runs."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import ray
from camera_server import PASSWORD, camera, free_port, needs_rtsp_server
from PIL import Image
from whole_run import DAMAGED, PLANTED, REPOSITORY, SECRET, FinishedRun, run_whole

from mlbs_actors import __version__
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.scenes.synthetic import scene
from orchestrator import ray_session
from orchestrator.__main__ import main
from orchestrator.command_line import command_again, parse
from orchestrator.monitor.address import MonitorAddress
from orchestrator.option_values import SAVED
from orchestrator.options import recorded
from orchestrator.ray_session import ray_settings
from orchestrator.run.argument_streams import DEMO
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_list import read_stream_list
from orchestrator.run.stream_state import StreamState


def stream_list(folder: Path, *lines: str) -> Path:
    path = folder / "list.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


# Flags


def test_the_defaults_are_those_of_the_help() -> None:
    arguments = parse(["--streams", "list.txt"])
    assert arguments.output == Path("out")
    assert arguments.save == frozenset({"masks", "parquet", "overlay"}) == frozenset(SAVED)
    assert (arguments.address, arguments.config, arguments.max_frames) == (None, None, None)
    assert not arguments.resume


@pytest.mark.parametrize(
    ("flags", "address"),
    [
        ([], None),
        (["--monitor"], MonitorAddress("127.0.0.1", 0)),
        (["--monitor", "8080"], MonitorAddress("127.0.0.1", 8080)),
        (["--monitor", "0.0.0.0:8080"], MonitorAddress("0.0.0.0", 8080)),
    ],
)
def test_the_monitor_stays_on_this_machine_unless_asked(
    flags: list[str], address: MonitorAddress | None
) -> None:
    assert parse(["--streams", "l", *flags]).monitor == address


def test_the_command_of_a_run_asks_for_the_same(tmp_path: Path) -> None:
    flags = ["--streams", "l", "--set", "a.b=1", "c.d=2", "--save", "masks", "--max-frames", "3"]
    given = parse(flags)
    python, module, name, *again = command_again(given, "elsewhere")
    assert (python, module, name) == (sys.executable, "-m", "orchestrator")
    asked = parse(again)
    assert asked.output == Path("elsewhere")
    assert asked.streams == Path("l").absolute()
    assert (asked.set, asked.save, asked.max_frames) == (given.set, given.save, given.max_frames)


def test_the_command_of_a_run_finds_its_sources_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "12:30 x.mp4").touch()
    given = parse(["12:30 x.mp4", "clips/*.mp4", "rtsp://host/door", "demo"])
    asked = parse(command_again(given, "elsewhere")[3:])
    assert asked.streams is None
    assert asked.sources == (
        *(str(tmp_path / "12:30 x.mp4"), str(tmp_path / "clips/*.mp4"), "rtsp://host/door"),
        DEMO,
    )


def test_set_may_be_given_once_or_often() -> None:
    arguments = parse(["--streams", "l", "--set", "a.b=1", "c.d=2", "--set", "e.f=3"])
    assert arguments.set == ("a.b=1", "c.d=2", "e.f=3")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--monitor", "web"], "PORT or HOST:PORT"),
        (["--monitor", "0.0.0.0:70000"], "PORT or HOST:PORT"),
        (["--save", "mask"], "knows no 'mask'"),
        (["--save", ""], "--save names nothing"),
        (["--address", "ray://head:10001"], "HOST:PORT"),
        (["--address", "nohost"], "HOST:PORT"),
        (["--address", ":6379"], "HOST:PORT"),
        (["--address", "head:port"], "HOST:PORT"),
        (["--output", "ftp://host/out"], "mount the storage"),
        (["--output", "s3://bucket"], "name a prefix of the run's own"),
        (["--output", "s3://key:secret@bucket/out"], "credentials and the server come from the environment"),
        (["--output", "file://out/here"], "takes file:///ABSOLUTE/PATH"),
        (["--scratch", "here"], "is for an object store as --output"),
        (["--output", r"C:\my out"], "--output '/mnt/c/my out'"),
        (["--watch", "a.mp4"], "--watch reads a list again"),
        (["--max-frames", "0"], "--max-frames '0' is not a whole number of at least 1"),
        (["--max-frames", "-3"], "'-3' is not a whole number"),
        (["--max-side", "3"], "at least 64"),
        (["--log", "xml"], "text or json"),
    ],
)
def test_what_is_not_there_is_refused_with_a_sentence(flags: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse([*([] if "--watch" in flags else ["--streams", "list.txt"]), *flags])


def test_a_wrong_flag_ends_with_status_2() -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--streams", "list.txt", "--what"])
    assert end.value.code == 2


def test_the_help_names_every_flag_source_output_and_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    flags = (
        "streams",
        "output",
        "config",
        "set",
        "address",
        "resume",
        "save",
        "monitor",
        "max-frames",
        "max-side",
    )
    for word in (
        *(f"--{flag}" for flag in flags),
        *("rtsp://", "/dev/videoN", "synthetic:", "status.json", "commits.jsonl", "overlay.mp4", "130"),
    ):
        assert word in text


# Refusals before anything starts


@pytest.mark.parametrize(
    ("lines", "flags", "words"),
    [
        ([], [], "holds no stream"),
        (["# mine", "gone.mp4", "away none/*.png"], [], "line 2: There is no file or folder"),
        (["a.mp4", "ftp://x/y", "a b c"], [], "line 2:"),
        (["synthetic:demo"], ["--set", "layers.nothing=1"], "nothing"),
        (["synthetic:demo"], ["--config", "none.yaml"], "none.yaml"),
        (["a.mp4", "yard rtsp://bob:hunter2@x/y z"], [], "line 2:"),
    ],
)
def test_a_bad_list_or_configuration_ends_with_status_2_and_leaves_no_trace(
    tmp_path: Path, lines: list[str], flags: list[str], words: str
) -> None:
    output = tmp_path / "out"
    ended = run_whole("--streams", stream_list(tmp_path, *lines), "--output", output, *flags)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert words in ended.stderr
    assert "Traceback" not in ended.stderr
    assert "hunter2" not in ended.stderr
    assert not output.exists()


@pytest.mark.parametrize("listed", [True, pytest.param(False, marks=pytest.mark.long)])
def test_files_that_are_no_videos_are_refused_before_ray_starts(tmp_path: Path, listed: bool) -> None:
    false = tmp_path / "false.mp4"
    false.write_text("no video")
    sources = ["--streams", stream_list(tmp_path, "# mine", "gone.mp4", "false.mp4")] if listed else [false]
    ended = run_whole(*sources, "--output", tmp_path / "out")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert str(false) in ended.stderr
    if listed:
        assert "line 2: There is no file" in ended.stderr
        assert "line 3: " in ended.stderr
    assert "Starting Ray" not in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not (tmp_path / "out").exists()


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"mlbs-actors {__version__}\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_program_is_still_loading_ends_it_without_a_traceback(
    tmp_path: Path, number: signal.Signals
) -> None:
    # The first thing that is imported after the handlers are set sends it.
    (tmp_path / "pydantic.py").write_text(f"import os\nos.kill(os.getpid(), {int(number)})\n")
    ended = subprocess.run(
        [sys.executable, "-m", "orchestrator", "--streams", "list.txt"],
        cwd=REPOSITORY,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (128 + number, "", "")


def test_a_missing_list_ends_with_status_2() -> None:
    ended = run_whole("--streams", "/nowhere/list.txt")
    assert ended.returncode == 2
    assert "/nowhere/list.txt" in ended.stderr


def _with_stubs(folder: Path, python: str) -> Path:
    """A copy of scripts/run beside stubs of what it calls."""
    for stub, does in (("scripts/setup", ""), (".venv/bin/python", python)):
        (folder / stub).parent.mkdir(parents=True)
        (folder / stub).write_text(f"#!/bin/sh\n{does}\n")
        (folder / stub).chmod(0o755)
    return Path(shutil.copy(REPOSITORY / "scripts/run", folder / "scripts/run"))


@pytest.mark.parametrize("given", [[], ["--max-frames", "3"], ["my clip.mp4", "--output=x"]])
def test_the_main_script_passes_its_arguments_on_with_the_name_by_which_it_was_called(
    tmp_path: Path, given: list[str]
) -> None:
    script = _with_stubs(tmp_path / "root", 'printf \'%s\\n\' "$MLBS_COMMAND" "$@"')
    ended = subprocess.run([script, *given], cwd=tmp_path, capture_output=True, text=True, check=True)
    program = str(tmp_path / "root/.venv/bin/mlbs-actors")
    assert ended.stdout.splitlines() == [str(script), program, "--or-demo", *given]


def test_the_main_script_becomes_the_program_that_signals_are_for(tmp_path: Path) -> None:
    script = _with_stubs(tmp_path / "root", "kill -TERM $$\nexit 3")
    assert subprocess.run([script], cwd=tmp_path, check=False).returncode == -signal.SIGTERM


# Sources as arguments


def test_the_main_script_runs_the_demo_where_no_source_is_named_and_other_commands_ask_for_one() -> None:
    assert parse(["--or-demo", "--max-frames", "3"]).sources == (DEMO,)
    assert parse(["--or-demo", "a.mp4"]).sources == ("a.mp4",)
    assert parse(["--or-demo", "--streams", "l"]).sources == ()
    with pytest.raises(ConfigError, match="Name a video"):
        parse(["--max-frames", "3"])


def test_sources_stand_before_between_and_after_flags_and_beside_a_list() -> None:
    given = parse(["a b.mp4", "--max-frames", "3", "c.mp4", "--streams", "l", "--resume", "demo"])
    assert given.sources == ("a b.mp4", "c.mp4", "demo")
    assert given.streams == Path("l")


@pytest.mark.parametrize(
    ("given", "there", "output"),
    [
        (["clips/a b.mp4"], [], "clips/a b-objects"),
        (["clips/a b.mp4"], ["clips/a b-objects"], "clips/a b-objects-2"),
        (["clips/a b.mp4"], ["clips/a b-objects", "clips/a b-objects-2"], "clips/a b-objects-3"),
        (["clips/a b.mp4", "--resume"], ["clips/a b-objects", "clips/a b-objects-2"], "clips/a b-objects-2"),
        (["clips/a b.mp4", "--resume"], [], "clips/a b-objects"),
        (["clips/"], [], "clips-objects"),
        (["."], [], "out"),
        (["clips/*.mp4"], [], "out"),
        (["clips/a b.mp4", "clips"], ["out"], "out-2"),
        (["rtsp://host/a.b"], [], "out"),
        (["demo"], ["out", "out-2"], "out-3"),
        (["clips/a b.mp4", "--streams", "l"], ["out"], "out"),
        (["--streams", "l"], ["out"], "out"),
        (["clips/a b.mp4", "--output", "x"], ["x"], "x"),
    ],
)
def test_results_go_beside_a_single_source_else_into_out_and_never_over_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[str], there: list[str], output: str
) -> None:
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips/a b.mp4").touch()
    for name in there:
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    assert parse(given).output == Path(output)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--out", "x", "a.mp4"], "there is no --out; did you mean --output?"),
        (["--frames=3"], "did you mean --max-frames?"),
        (["-o", "x"], "did you mean --output?"),
        (["--bogus"], "run --help lists all flags"),
        (["--", "-a.mp4"], "to name the file write ./-a.mp4"),
    ],
)
def test_an_unknown_flag_is_told_with_the_one_that_is_meant(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    flags: list[str],
    words: str,
) -> None:
    (tmp_path / "-a.mp4").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        parse(flags)
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("flag", ["--set", "--monitor", "--ray-metrics"])
def test_a_video_behind_a_flag_that_takes_it_for_its_value_is_told_where_to_stand(
    tmp_path: Path, flag: str
) -> None:
    video = tmp_path / "a b.mp4"
    video.touch()
    with pytest.raises(ConfigError, match="name your sources first: .*'.*/a b.mp4' " + flag):
        parse([flag, str(video)])


@pytest.mark.parametrize(
    ("script", "started", "name"),
    [
        ("scripts/run", "/x/orchestrator/__main__.py", "scripts/run"),
        ("my clone/scripts/run", "/x/orchestrator/__main__.py", "'my clone/scripts/run'"),
        ("", "/home/me/.local/bin/mlbs-actors", "mlbs-actors"),
        ("", "/x/orchestrator/__main__.py", "python -m orchestrator"),
    ],
)
def test_the_help_begins_with_examples_of_the_command_that_was_typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], script: str, started: str, name: str
) -> None:
    monkeypatch.setenv("MLBS_COMMAND", script)
    monkeypatch.setattr(sys, "argv", [started])
    with pytest.raises(SystemExit):
        parse(["--help"])
    first, *examples = capsys.readouterr().out.split("\n\n")[0].splitlines()
    assert first == "examples:"
    assert [line.startswith(f"  {name} ") for line in examples] == [True] * 3


def test_an_output_folder_that_holds_a_run_is_refused_untouched(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/run.json").write_text("{}")
    ended = run_whole("--streams", stream_list(tmp_path, "synthetic:demo"), "--output", tmp_path / "out")
    assert ended.returncode == 2
    assert "holds a run already" in ended.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["run.json"]


def test_a_run_that_is_at_its_end_is_gone_on_with_without_ray(tmp_path: Path) -> None:
    given = ("--streams", stream_list(tmp_path, "street street.mp4"), "--output", tmp_path / "out")
    (tmp_path / "street.mp4").write_bytes(b"read before")
    arguments = parse([str(word) for word in given])
    assert arguments.streams is not None
    streams, config = read_stream_list(arguments.streams).streams, Config()
    folder = RunFolder(tmp_path / "out")
    folder.create(describe_run(streams, config, recorded({"save": arguments.save})))
    StatusFile(folder.path / "status.json").finish([StreamState("street", "done", read=9, committed=9)], 0)
    ended = run_whole(*given, "--resume")
    assert ended.returncode == 0, ended.stderr
    assert "1 stream ended before" in ended.stderr
    assert "1 of 1 stream complete" in ended.stderr
    assert "Starting Ray" not in ended.stderr
    assert ended.stdout == "street: done, 9 frames\n"
    assert (folder.path / "report.html").stat().st_size


def test_a_ray_that_does_not_run_on_this_machine_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def init(**_: object) -> None:
        raise ConnectionError("Could not find any running Ray instance")

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "shutdown", lambda: None)  # other tests use theirs
    with pytest.raises(ConfigError, match="finds no Ray on this machine; start it"):
        ray_session.ray_session("auto", tmp_path).__enter__()


@pytest.mark.parametrize(
    "address", ["127.0.0.1:9", pytest.param("nowhere.invalid:6379", marks=pytest.mark.long)]
)
def test_a_cluster_that_cannot_be_reached_ends_with_status_2_soon(tmp_path: Path, address: str) -> None:
    path, output = stream_list(tmp_path, "synthetic:demo"), tmp_path / "out"
    started = time.monotonic()
    ended = run_whole("--streams", path, "--output", output, "--address", address)
    assert ended.returncode == 2
    assert "cannot be joined" in ended.stderr
    assert not output.exists()
    assert time.monotonic() - started < 60


def test_without_the_packages_of_a_run_the_command_names_them_and_how_to_get_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("orchestrator.extra.find_spec", lambda name: None if name in ("av", "ray") else name)
    monkeypatch.setattr("orchestrator.__main__.exit_on_signals", lambda: None)  # the test run has its own
    assert main(["a.mp4"]) == 2
    message = capsys.readouterr().err
    assert "(av, ray)" in message
    assert "[run]" in message


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_without_the_packages_of_a_run_the_command_shows_its_help(
    flag: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("orchestrator.extra.find_spec", lambda _: None)
    monkeypatch.setattr("orchestrator.__main__.exit_on_signals", lambda: None)  # the test run has its own
    assert main(["a.mp4", flag]) == 0
    shown = capsys.readouterr()
    assert "--output" in shown.out
    assert shown.err == ""


def test_settings_of_ray_come_before_ray_or_not_at_all() -> None:
    code = "import ray, orchestrator.ray_session as r\nwith r.ray_settings(None): pass"
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert "RuntimeError: Ray is imported already" in ended.stderr


def test_settings_of_ray_hold_a_token_that_only_the_user_reads_and_are_undone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.setenv("RAY_ADDRESS", "elsewhere:1")
    with ray_settings(None) as scratch:
        token = Path(os.environ["RAY_AUTH_TOKEN_PATH"])
        assert os.environ["RAY_AUTH_MODE"] == "token"
        assert "RAY_ADDRESS" not in os.environ
        assert len(token.read_text()) == 64
        assert [path.stat().st_mode & 0o077 for path in (token, scratch)] == [0, 0]
    assert os.environ["RAY_ADDRESS"] == "elsewhere:1"
    assert not scratch.exists()


@pytest.mark.parametrize(("address", "seen"), [("here:2", None), ("auto", "elsewhere:1")])
def test_the_cluster_of_the_environment_counts_only_if_that_of_this_machine_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, address: str, seen: str | None
) -> None:
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.setenv("RAY_ADDRESS", "elsewhere:1")
    with ray_settings(address):
        assert os.environ.get("RAY_ADDRESS") == seen


def test_what_a_late_process_of_ray_leaves_in_its_folder_is_removed_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    removals = []

    def remove(folder: Path, *, ignore_errors: bool) -> None:
        removals.append(folder)
        if len(removals) == 3:  # up to then somebody writes
            folder.rmdir()

    monkeypatch.setattr(shutil, "rmtree", remove)
    ray_session._remove(scratch)
    assert (len(removals), scratch.exists()) == (3, False)


def test_what_a_killed_run_has_left_is_removed_and_nothing_of_a_living_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (
        "import pathlib, sys, time, orchestrator.ray_session as r\n"
        "r._SCRATCH_PARENT = pathlib.Path(sys.argv[1])\n"
        "with r.ray_settings(None) as scratch: print(scratch, flush=True); time.sleep(60)"
    )
    begin = [sys.executable, "-c", code, str(tmp_path)]
    (tmp_path / "mlbs-ray-file").touch()
    (tmp_path / "others").mkdir()
    with (
        subprocess.Popen(begin, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as killed,
        subprocess.Popen(begin, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as living,
    ):
        left, kept = (Path(run.stdout.readline().strip()) for run in (killed, living) if run.stdout)
        killed.kill()
        killed.wait()
        assert (left / "token").exists()
        monkeypatch.delitem(sys.modules, "ray", raising=False)
        monkeypatch.setattr(ray_session, "_SCRATCH_PARENT", tmp_path)
        with ray_settings(None) as scratch:
            assert {path.name for path in tmp_path.iterdir()} == {
                *("mlbs-ray-file", "others", kept.name, scratch.name)
            }
            assert (kept / "token").exists()
        living.kill()


@pytest.mark.parametrize("moment", ["before it is opened", "before it is locked"])
def test_a_new_folder_that_a_run_beside_takes_for_abandoned_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    make, lock = tempfile.mkdtemp, fcntl.flock
    removed: list[Path] = []

    def run_beside(folder: Path) -> None:
        if not removed:  # the first folder only
            removed.append(folder)
            folder.rmdir()

    def made(prefix: str, dir: Path) -> str:
        folder = make(prefix=prefix, dir=dir)
        if moment == "before it is opened":
            run_beside(Path(folder))
        return folder

    def locked(descriptor: int, operation: int) -> None:
        if moment == "before it is locked" and operation == fcntl.LOCK_EX:
            run_beside(Path(f"/proc/self/fd/{descriptor}").resolve())
        lock(descriptor, operation)

    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.setattr(ray_session, "_SCRATCH_PARENT", tmp_path)
    monkeypatch.setattr(tempfile, "mkdtemp", made)
    monkeypatch.setattr(fcntl, "flock", locked)
    with ray_settings(None) as scratch:
        assert removed
        assert [scratch] == list(tmp_path.iterdir())
        assert scratch not in removed


# Whole runs


def _masks(stream: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((stream / "masks").iterdir())}


def _frames(stream: Path) -> list[dict[str, object]]:
    return [
        row for part in sorted(stream.glob("frames-*.parquet")) for row in pq.read_table(part).to_pylist()
    ]


#: Prints the niceness of a process of a session of our own, and this one's.
_NICENESS = """
import os
from orchestrator.ray_session import ray_session, ray_settings
with ray_settings(None) as scratch:
    import ray
    with ray_session(None, scratch):
        theirs = ray.get(ray.remote(num_cpus=0)(lambda: os.nice(0)).remote())
print(theirs, os.nice(0))
"""


@pytest.mark.long
@pytest.mark.ray
def test_processes_of_a_session_of_our_own_are_as_nice_as_the_command() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", _NICENESS], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    theirs, ours = ended.stdout.split()[-2:]
    assert theirs == ours, ended.stderr


@pytest.mark.ray
def test_a_run_over_good_damaged_and_missing_sources_keeps_all_that_can_be_kept(
    finished_run: FinishedRun,
) -> None:
    output = finished_run.output
    assert finished_run.exit_status == 1, finished_run.stderr
    status = json.loads((output / "status.json").read_text())["streams"]
    assert {
        name: (s["state"], s["read"], s["committed"], s["quarantined"]) for name, s in status.items()
    } == {
        "demo": ("done", 12, 12, 0),
        "folder": ("partial", 12, 11, 1),
        "gone": ("failed", 0, 0, 0),
        "door": ("failed", 0, 0, 0),
    }
    assert list(_masks(output / "demo")) == [f"{index:05d}.png" for index in range(12)]
    assert len(_masks(output / "folder")) == 11
    assert "p4.png" not in _masks(output / "folder")
    assert [row["status"] for row in _frames(output / "folder")].index("quarantined") == DAMAGED
    labels = np.asarray(Image.open(output / "demo/masks/00011.png"))
    assert labels.shape == (120, 160)
    for name in ("run.json", "report.html", "demo/overlay.mp4", "demo/commits.jsonl"):
        assert (output / name).stat().st_size


@pytest.mark.ray
def test_a_run_says_what_is_wrong_with_which_line_and_where_its_results_are(
    finished_run: FinishedRun,
) -> None:
    status = json.loads((finished_run.output / "status.json").read_text())["streams"]
    assert status["gone"]["line"] == 3
    before_ray, _, _ = finished_run.stderr.partition("Starting Ray")
    assert f"line 3: There is no file or folder {finished_run.sources / 'none.mp4'}" in before_ray
    assert "line 4, door (failed): " in finished_run.stderr
    last = [json.loads(line) for line in finished_run.stdout.splitlines()]
    assert {line["stream"]: line["state"] for line in last} == {
        name: stream["state"] for name, stream in status.items()
    }
    assert str(finished_run.output) in finished_run.stderr
    everything = finished_run.stdout + finished_run.stderr
    everything += "".join(path.read_text() for path in finished_run.output.glob("*.*"))
    assert SECRET not in everything
    assert "Traceback" not in everything


@pytest.mark.ray
def test_nothing_of_the_folder_in_which_the_command_is_given_is_run(finished_run: FinishedRun) -> None:
    assert (finished_run.output / "report.html").exists(), finished_run.stderr
    assert all((finished_run.sources / f"{name}.py").exists() for name in PLANTED)
    assert not list(finished_run.sources.glob("*.was-run"))


@dataclass(frozen=True, slots=True)
class VideoRun:
    """A run over a video named as an argument, from its folder.

    Attributes
    ----------
    folder : Path
        Of the video.
    arguments : tuple of str
    ended : subprocess.CompletedProcess
    """

    folder: Path
    arguments: tuple[str, ...]
    ended: subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def video_run(tmp_path_factory: pytest.TempPathFactory) -> VideoRun:
    folder = tmp_path_factory.mktemp("films") / "my clips"
    folder.mkdir()
    writer = cv2.VideoWriter(str(folder / "x.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25, (160, 120))
    street = scene("demo", frames=8, width=160, height=120)
    for index in range(8):
        writer.write(street.frame(index))
    writer.release()
    (folder / "x.mp4").rename(folder / "street [1].mp4")
    arguments = ("street [1].mp4", "--max-frames", "8", "--save", "masks")
    return VideoRun(folder, arguments, run_whole(*arguments, folder=folder))


@pytest.mark.long
@pytest.mark.ray
def test_a_video_named_as_an_argument_has_its_results_beside_it_where_the_run_goes_on(
    video_run: VideoRun,
) -> None:
    results = video_run.folder / "street [1]-objects"
    assert video_run.ended.returncode == 0, video_run.ended.stderr
    assert f"Results: {results}\n" in video_run.ended.stderr
    assert len(_masks(results / "street [1]")) == 8
    ended = run_whole(
        *(video_run.folder / "street [1].mp4", "--output", results),
        *("--max-frames", "8", "--save", "masks", "--resume"),
    )
    assert "1 stream ended before" in ended.stderr
    assert f"Results: {results}\n" in ended.stderr


@pytest.mark.long
@pytest.mark.ray
def test_away_from_a_terminal_a_run_prints_lines_for_people(video_run: VideoRun) -> None:
    first, *_, last = video_run.ended.stdout.splitlines()
    assert first.startswith("street [1]: starting")
    assert last == "street [1]: done, 8 frames"
    assert "1 file, 8 frames: up to 1 second once running" in video_run.ended.stderr.partition("complete")[0]


@pytest.mark.long
@pytest.mark.ray
def test_a_run_whose_output_nobody_reads_any_more_ends_quietly_and_says_how_it_goes_on(
    video_run: VideoRun,
) -> None:
    first = (video_run.folder / "street [1]-objects/status.json").read_bytes()
    words = [sys.executable, "-m", "orchestrator", *video_run.arguments]
    with subprocess.Popen(
        words, cwd=video_run.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        assert run.stderr is not None
        run.stdout.readline()
        run.stdout.close()
        stderr = run.stderr.read()
    output = video_run.folder / "street [1]-objects-2"  # a second run does not touch the first one's results
    assert run.returncode == 141, stderr
    for word in ("Traceback", "BrokenPipe", "second signal"):
        assert word not in stderr
    assert f"Results: {output}\n" in stderr
    assert f"give the same command with --resume --output '{output}'." in stderr
    status = json.loads((output / "status.json").read_text())
    assert status["exit_status"] == 141
    assert status["streams"]["street [1]"]["read"] == status["streams"]["street [1]"]["committed"]
    assert (video_run.folder / "street [1]-objects/status.json").read_bytes() == first


@pytest.mark.ray
def test_with_json_lines_messages_and_progress_have_one_schema(finished_run: FinishedRun) -> None:
    messages = [json.loads(line) for line in finished_run.stderr.splitlines()]
    progress = [json.loads(line) for line in finished_run.stdout.splitlines()]
    for line in (*messages, *progress):
        assert list(line)[:5] == ["time", "level", "run", "stream", "event"]
        assert datetime.fromisoformat(line["time"].replace("Z", "+00:00")).utcoffset() == timedelta(0)
        assert line["run"] == str(finished_run.output)
        assert line["level"] in ("info", "warning", "error")
    assert {line["event"] for line in messages} == {"message"}
    assert {line["event"] for line in progress} <= {"state", "progress"}
    assert {line["stream"] for line in progress} == {"demo", "folder", "gone", "door"}


#: Gets a signal while Python finalises an object, where it drops whatever is raised, and then starts Ray.
_LOST = """
import os, pathlib, sys
from orchestrator.early_signals import exit_on_signals
from orchestrator.ray_session import ray_session
class Finalised:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))
        print("signalled")
exit_on_signals()
Finalised()
print("went on", flush=True)
with ray_session(None, pathlib.Path(sys.argv[2])):
    print("started")
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_whose_exit_python_has_dropped_ends_the_command_before_ray_starts(
    tmp_path: Path, number: signal.Signals
) -> None:
    words = [sys.executable, "-c", _LOST, str(int(number)), str(tmp_path)]
    ended = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, timeout=200, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (128 + number, "went on\n", "")
    assert not list(tmp_path.iterdir())


@pytest.mark.ray
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_a_signal_to_its_group_while_ray_starts_ends_the_command_without_a_word(
    tmp_path: Path, number: signal.Signals
) -> None:
    words = [sys.executable, "-m", "orchestrator", "synthetic:no-mover", "--output", str(tmp_path / "out")]
    with subprocess.Popen(
        words,
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        assert run.stderr is not None
        # Before that, what is there may be of a killed run whose process had the same number.
        assert run.stderr.readline().startswith("Starting Ray")
        _wait_for(lambda: any(folder.glob("session_*") for folder in _session_folders(run.pid)), 120)
        os.killpg(run.pid, number)
        stdout, stderr = run.communicate(timeout=200)
    assert run.returncode == 128 + number, stderr
    assert stdout == ""
    assert all(line.startswith(("Starting Ray", "1 file, ")) for line in stderr.splitlines())
    assert not (tmp_path / "out").exists()
    assert not _session_folders(run.pid)


def _session_folders(driver: int) -> set[Path]:
    """Those of one run, told by its process: other runs may begin meanwhile."""
    return set(Path("/tmp").glob(f"mlbs-ray-{driver}-*"))


def _wait_for(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.1)


def _signal_descendants(process: int, number: int) -> None:
    """Signal a process and all that it has started, in whatever group or session they are."""
    for task in Path(f"/proc/{process}/task").iterdir():
        for child in (task / "children").read_text().split():
            with contextlib.suppress(OSError):  # it has ended
                _signal_descendants(int(child), number)
    os.kill(process, number)


@pytest.mark.long
@pytest.mark.ray
@pytest.mark.parametrize(
    ("number", "to"),
    [(signal.SIGINT, os.killpg), (signal.SIGTERM, os.killpg), (signal.SIGTERM, _signal_descendants)],
)
def test_a_signal_to_all_its_processes_ends_a_run_cleanly_with_all_that_was_read_committed(
    tmp_path: Path, number: signal.Signals, to: Callable[[int, int], None]
) -> None:
    path = stream_list(
        tmp_path, "demo 'synthetic:no-mover?frames=5000&width=64&height=48'", "late synthetic:no-mover"
    )
    output = tmp_path / "out"
    run = subprocess.Popen(
        [sys.executable, "-m", "orchestrator", "--streams", str(path), "--output", str(output)],
        cwd=REPOSITORY,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with run:
        _wait_for(lambda: (output / "demo/commits.jsonl").exists(), 120)
        to(run.pid, number)  # as a terminal and timeout do, and a service manager
        _, stderr = run.communicate(timeout=60)
    assert run.returncode == 128 + number, stderr
    for words in (
        "a second signal ends the run at once",
        f"give the same command with --resume --output {output}.",
    ):
        assert stderr.count(words) == 1
    status = json.loads((output / "status.json").read_text())["streams"]["demo"]
    assert status["state"] == "partial"
    assert 0 < status["read"] == status["committed"] < 5000
    assert len(_masks(output / "demo")) == status["committed"]
    assert [row["frame"] for row in _frames(output / "demo")] == list(range(status["read"]))
    assert not _session_folders(run.pid)


@needs_rtsp_server
@pytest.mark.ray
@pytest.mark.long
def test_a_watched_list_with_a_camera_that_goes_away_and_comes_back(tmp_path: Path) -> None:
    port, output = free_port(), tmp_path / "out"
    door = f"door rtsp://bob:{PASSWORD}@127.0.0.1:{port}/door"
    path = stream_list(tmp_path, "endless 'synthetic:demo?frames=5000&width=160&height=120'", door)

    def streams() -> dict[str, dict[str, object]]:
        status: dict[str, dict[str, dict[str, object]]] = json.loads((output / "status.json").read_text())
        return status["streams"]

    def is_in(name: str, state: str, least: int = 0) -> Callable[[], bool]:
        return lambda: streams()[name]["state"] == state and cast(int, streams()[name]["committed"]) >= least

    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "orchestrator", "--watch", "--max-side", "80"),
            *("--streams", str(path), "--output", str(output)),
        ],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    with run:
        with camera(port):
            _wait_for((output / "door/commits.jsonl").exists, 200)
            stream_list(tmp_path, "late 'synthetic:demo?frames=6&width=64&height=48'", "x y z", door)
            _wait_for(lambda: "late" in streams(), 60)
            assert streams()["endless"]["state"] == "running"
            stream_list(tmp_path, "late 'synthetic:demo?frames=6&width=64&height=48'", door)
            _wait_for(is_in("endless", "done"), 60)
            _wait_for(is_in("late", "done", 6), 60)
        _wait_for(is_in("door", "reconnecting"), 60)
        assert "unreachable since" in str(streams()["door"]["error"])
        with camera(port):
            _wait_for(is_in("door", "running"), 60)
            time.sleep(2.0)
            run.send_signal(signal.SIGINT)
            shown, _ = run.communicate(timeout=60)
    assert run.returncode == 0, shown
    assert "line 2: has 3 words" in shown
    last = streams()
    for name in ("endless", "late", "door"):
        counts = [cast(int, last[name][key]) for key in ("read", "committed", "dropped", "quarantined")]
        assert counts[0] == sum(counts[1:])
        rows = [row["status"] for row in _frames(output / name)]
        without = [rows.count("dropped"), rows.count("gap")]
        assert [len(rows) - sum(without), *without] == [counts[1], counts[2], last[name]["gaps"]]
    assert last["door"]["gaps"] == 1
    masks = _masks(output / "door")
    assert np.asarray(Image.open(output / "door/masks" / min(masks))).shape == (120, 160)
    assert list(json.loads((output / "run.json").read_text())["sources"]) == ["endless", "door", "late"]
    everything = shown + "".join(file.read_text() for file in output.glob("*.*"))
    assert PASSWORD not in everything


@pytest.mark.ray
@pytest.mark.long
def test_the_same_command_starts_a_watched_run_and_continues_it_with_another_list(tmp_path: Path) -> None:
    small = "'synthetic:demo?frames=5000&width=64&height=48'"
    path, output = (
        stream_list(tmp_path, f"stays {small}", f"other {small}", f"goes {small}"),
        tmp_path / "out",
    )
    words = [
        *(sys.executable, "-m", "orchestrator", "--watch", "--resume", "--save", "masks"),
        *("--streams", str(path), "--output", str(output)),
    ]

    def commits(name: str) -> bytes:
        log = output / name / "commits.jsonl"
        return log.read_bytes() if log.exists() else b""

    with subprocess.Popen(words, cwd=REPOSITORY, stdout=subprocess.DEVNULL) as first:
        _wait_for(lambda: all(map(commits, ("stays", "other", "goes"))), 200)
        first.kill()
    kept = commits("stays")
    stream_list(tmp_path, f"stays {small}", "other synthetic:street", f"new {small}")
    with subprocess.Popen(
        words, cwd=REPOSITORY, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as second:
        _wait_for(lambda: len(commits("stays")) > len(kept) and bool(commits("new")), 200)
        second.send_signal(signal.SIGTERM)
        _, stderr = second.communicate(timeout=60)
    assert second.returncode == 143, stderr
    assert "line 2: The name 'other' stands for synthetic:demo" in stderr
    assert commits("stays").startswith(kept)
    states = json.loads((output / "status.json").read_text())["streams"]
    assert {name: state["state"] for name, state in states.items()} == {
        "stays": "partial",
        "new": "partial",
        "goes": "done",
        "other": "failed",
    }
    assert list(json.loads((output / "run.json").read_text())["sources"]) == ["stays", "other", "goes", "new"]
