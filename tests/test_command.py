"""The command as a user meets it: its flags, its refusals, its exit status, whole runs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from mlbs_actors.errors import ConfigError
from orchestrator.command_line import SAVABLE, parse
from orchestrator.ray_session import ray_settings
from orchestrator.sources.synthetic import scene

REPOSITORY = Path(__file__).resolve().parents[1]


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "orchestrator", *map(str, arguments)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def stream_list(folder: Path, *lines: str) -> Path:
    path = folder / "list.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


# Flags


def test_the_defaults_are_those_of_the_help() -> None:
    arguments = parse(["--streams", "list.txt"])
    assert arguments.output == Path("out")
    assert arguments.save == frozenset({"masks", "parquet", "overlay"}) == frozenset(SAVABLE)
    assert (arguments.address, arguments.config, arguments.max_frames) == (None, None, None)
    assert not arguments.resume


def test_set_may_be_given_once_or_often() -> None:
    arguments = parse(["--streams", "l", "--set", "a.b=1", "c.d=2", "--set", "e.f=3"])
    assert arguments.overrides == ("a.b=1", "c.d=2", "e.f=3")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--monitor"], "not available yet"),
        (["--monitor", "8080"], "not available yet"),
        (["--save", "masks,background"], "background is not available yet"),
        (["--save", "mask"], "knows no 'mask'"),
        (["--save", ""], "knows no ''"),
        (["--address", "ray://head:10001"], "HOST:PORT"),
    ],
)
def test_what_is_not_there_is_refused_with_a_sentence(flags: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse(["--streams", "list.txt", *flags])


@pytest.mark.parametrize(
    "flags", [["--max-frames", "0"], ["--max-frames", "-3"], ["--max-frames", "x"], ["--what"]]
)
def test_a_wrong_flag_or_value_ends_with_status_2(flags: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--streams", "list.txt", *flags])
    assert end.value.code == 2


def test_the_help_names_every_flag_source_output_and_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    flags = ("streams", "output", "config", "set", "address", "resume", "save", "monitor", "max-frames")
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
        (["a.mp4", "http://x/y", "a b c"], [], "line 2:"),
        (["a.mp4"], ["--set", "layers.nothing=1"], "nothing"),
        (["a.mp4"], ["--config", "none.yaml"], "none.yaml"),
        (["a.mp4", "yard rtsp://bob:hunter2@x/y z"], [], "line 2:"),
    ],
)
def test_a_bad_list_or_configuration_ends_with_status_2_and_leaves_no_trace(
    tmp_path: Path, lines: list[str], flags: list[str], words: str
) -> None:
    output = tmp_path / "out"
    ended = command("--streams", stream_list(tmp_path, *lines), "--output", output, *flags)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert words in ended.stderr
    assert "Traceback" not in ended.stderr
    assert "hunter2" not in ended.stderr
    assert not output.exists()


def test_a_missing_list_ends_with_status_2() -> None:
    ended = command("--streams", "/nowhere/list.txt")
    assert ended.returncode == 2
    assert "/nowhere/list.txt" in ended.stderr


def test_an_output_folder_that_holds_a_run_is_refused_untouched(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/run.json").write_text("{}")
    ended = command("--streams", stream_list(tmp_path, "a.mp4"), "--output", tmp_path / "out")
    assert ended.returncode == 2
    assert "holds a run already" in ended.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["run.json"]


@pytest.mark.parametrize("address", ["127.0.0.1:9", "nowhere.invalid:6379", "head", ":"])
def test_a_cluster_that_cannot_be_reached_ends_with_status_2_soon(tmp_path: Path, address: str) -> None:
    path, output = stream_list(tmp_path, "synthetic:demo"), tmp_path / "out"
    started = time.monotonic()
    ended = command("--streams", path, "--output", output, "--address", address)
    assert ended.returncode == 2
    assert "cannot be joined" in ended.stderr
    assert not output.exists()
    assert time.monotonic() - started < 60


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


# Whole runs


def _masks(stream: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((stream / "masks").iterdir())}


def _frames(stream: Path) -> list[dict[str, object]]:
    return [
        row for part in sorted(stream.glob("frames-*.parquet")) for row in pq.read_table(part).to_pylist()
    ]


@pytest.mark.ray
def test_a_run_over_good_damaged_and_missing_sources_keeps_all_that_can_be_kept(tmp_path: Path) -> None:
    pictures = [scene("demo", frames=12, width=160, height=120).frame(index) for index in range(12)]
    (tmp_path / "folder").mkdir()
    for index, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"folder/p{index}.png"), picture)
    (tmp_path / "folder/p4.png").write_bytes(b"damaged")
    lines = [
        "demo 'synthetic:demo?frames=12&width=160&height=120'",
        "twin 'synthetic:demo?frames=12&width=160&height=120'",
        "folder",
        "gone none.mp4",
        "door rtsp://bob:hunter2@127.0.0.1:9/door",
    ]
    output = tmp_path / "out"
    ended = command("--streams", stream_list(tmp_path, *lines), "--output", output)
    assert ended.returncode == 1, ended.stderr
    status = json.loads((output / "status.json").read_text())["streams"]
    assert {
        name: (s["state"], s["read"], s["committed"], s["quarantined"]) for name, s in status.items()
    } == {
        "demo": ("done", 12, 12, 0),
        "twin": ("done", 12, 12, 0),
        "folder": ("partial", 12, 11, 1),
        "gone": ("failed", 0, 0, 0),
        "door": ("failed", 0, 0, 0),
    }
    assert list(_masks(output / "demo")) == [f"{index:05d}.png" for index in range(12)]
    assert _masks(output / "demo") == _masks(output / "twin")
    assert len(_masks(output / "folder")) == 11
    assert "p4.png" not in _masks(output / "folder")
    assert [row["status"] for row in _frames(output / "folder")].index("quarantined") == 4
    labels = np.asarray(Image.open(output / "demo/masks/00011.png"))
    assert labels.shape == (120, 160)
    for name in ("run.json", "report.html", "demo/overlay.mp4", "demo/commits.jsonl"):
        assert (output / name).stat().st_size
    last = [json.loads(line) for line in ended.stdout.splitlines()]
    assert {line["stream"]: line["state"] for line in last} == {
        name: stream["state"] for name, stream in status.items()
    }
    assert str(output) in ended.stderr
    everything = ended.stdout + ended.stderr
    everything += "".join(path.read_text() for path in output.glob("*.*"))
    assert "hunter2" not in everything
    assert "Traceback" not in everything


def _session_folders() -> set[Path]:
    return set(Path("/tmp").glob("mlbs-ray-*"))


def _wait_for(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.1)


@pytest.mark.ray
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_signal_ends_a_run_cleanly_with_all_that_was_read_committed(
    tmp_path: Path, number: signal.Signals
) -> None:
    path = stream_list(
        tmp_path, "demo 'synthetic:demo?frames=5000&width=64&height=48'", "late synthetic:demo"
    )
    output, before = tmp_path / "out", _session_folders()
    run = subprocess.Popen(
        [sys.executable, "-m", "orchestrator", "--streams", str(path), "--output", str(output)],
        cwd=REPOSITORY,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    with run:
        _wait_for(lambda: (output / "demo/commits.jsonl").exists(), 120)
        run.send_signal(number)
        _, stderr = run.communicate(timeout=60)
    assert run.returncode == 128 + number, stderr
    status = json.loads((output / "status.json").read_text())["streams"]["demo"]
    assert status["state"] == "partial"
    assert 0 < status["read"] == status["committed"] < 5000
    assert len(_masks(output / "demo")) == status["committed"]
    assert [row["frame"] for row in _frames(output / "demo")] == list(range(status["read"]))
    assert _session_folders() <= before
