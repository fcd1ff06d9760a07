"""One overlay for a stream that went back or was resumed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import av
import numpy as np
import pytest
from record_fakes import segmentation
from sounding_video import FRAME_RATE, write_sounding_video

from mlbs_actors.config import Config
from mlbs_actors.messages import Array
from mlbs_actors.record.recorded_stream import recorded_stream
from mlbs_actors.source import SourceFrame
from orchestrator.options import recorded
from orchestrator.pictures.content import DEFAULT_DRAWING
from orchestrator.run.job import Job
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_list import read_stream_list
from orchestrator.run.stream_state import StreamState
from orchestrator.run.whole_overlays import is_in_parts, is_lost, make_all_whole, make_whole
from orchestrator.sinks.overlay import OverlayVideo, overlays
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SAVED = frozenset({"masks", "parquet", "overlay"})
SIZE = (50, 36)
REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "film.mp4"
    write_sounding_video(path, "aac", size=SIZE)
    return path


def written(folder: Path, source: Path, until: int | None = None, *, killed: bool = False) -> None:
    """Open the record, write frames from the source's start, and end as a run does that was interrupted."""
    address = parse_address(str(source), source.parent)
    reader = open_reader(address)
    record = StreamRecord(folder, folder.name, SAVED, source=address)
    while isinstance(frame := reader.read(), SourceFrame):
        if until is not None and frame.index == until - 2 and not killed:
            record.provisional()
        # A provisional label map is another one.
        layer = 9 if until is not None and frame.index >= until - 2 else 3
        record.write(segmentation(frame.index, layer), frame)
        if frame.index + 1 == until:
            break
    if not killed:
        record.close(whole=until is None)


def shown(path: Path) -> tuple[Array, list[float | None], float]:
    """Pictures and times of a video, and the length of its sound, s."""
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
        pictures = np.stack([frame.to_ndarray(format="rgb24") for frame in frames])
    with av.open(str(path)) as container:
        sound = sum(frame.samples for frame in container.decode(audio=0)) / 48_000
    return pictures, [frame.time for frame in frames], sound


@pytest.mark.parametrize("killed", [False, True])
def test_parts_become_the_overlay_of_an_undisturbed_run(
    tmp_path: Path, source: Path, killed: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path / "whole", source)
    folder = tmp_path / "yard"
    written(folder, source, 45, killed=killed)
    written(folder, source)
    assert is_in_parts(folder)
    assert [first for first, _ in overlays(folder)] == ([32] if killed else [0, 43])
    said: list[str] = []
    make_whole(folder, str(source), said.append)
    assert said == ["Drawing the overlay of yard anew, in one piece."]
    assert [path.name for path in folder.glob("*overlay*")] == ["overlay.mp4"]
    pictures, times, sound = shown(folder / "overlay.mp4")
    expected, expected_times, expected_sound = shown(tmp_path / "whole/overlay.mp4")
    np.testing.assert_array_equal(pictures, expected)
    assert (times, sound) == (expected_times, expected_sound)
    assert sound == pytest.approx(60 / float(FRAME_RATE), abs=0.03)
    assert not is_in_parts(folder)


def test_parts_stay_if_the_source_is_gone(tmp_path: Path, source: Path) -> None:
    folder = tmp_path / "yard"
    written(folder, source, 45)
    written(folder, source)
    before = {path: path.read_bytes() for path in folder.glob("*overlay*")}
    said: list[str] = []
    make_whole(folder, "/nowhere/film.mp4", said.append)
    assert "gave 0 of its 60 frames" in said[-1]
    assert {path: path.read_bytes() for path in folder.glob("*overlay*")} == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_drawing_but_not_the_run(
    tmp_path: Path,
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
    signals_exit: None,
    number: signal.Signals,
) -> None:
    for name in ("yard", "gate"):
        written(tmp_path / name, source, 45)
        written(tmp_path / name, source)
    before = {path: path.read_bytes() for path in tmp_path.glob("*/*overlay*")}

    def add_until_signalled(*given: object) -> None:
        os.kill(os.getpid(), number)
        raise AssertionError("the signal did not come")

    monkeypatch.setattr(OverlayVideo, "add", add_until_signalled)
    said: list[str] = []
    asked = SimpleNamespace(rules=SimpleNamespace(zones=()), drawing=DEFAULT_DRAWING)
    specs = [SimpleNamespace(name=name, source=str(source), live=False) for name in ("yard", "gate")]
    job = cast(Job, SimpleNamespace(specs=specs, settings=lambda name: asked))
    states = [StreamState(name, "done", committed=60) for name in ("yard", "gate")]
    assert not make_all_whole(job, {"yard", "gate"}, states, RunFolder(tmp_path), said.append)
    assert said == [
        "Drawing the overlay of yard anew, in one piece.",
        "The overlay of yard stays as it is; to go on, give the same command with --resume.",
    ]
    assert {path: path.read_bytes() for path in tmp_path.glob("*/*overlay*")} == before


def test_only_an_overlay_that_left_no_trace_is_lost(tmp_path: Path, source: Path) -> None:
    written(tmp_path / "yard", source, 45, killed=True)
    assert is_lost(tmp_path / "yard")
    (tmp_path / "yard/overlay.error").write_text("The disk is full.")
    assert not is_lost(tmp_path / "yard")


@pytest.mark.long
def test_the_command_that_resumes_a_run_leaves_one_overlay(tmp_path: Path, source: Path) -> None:
    (tmp_path / "list.txt").write_text(f"yard {source}\n")
    streams = read_stream_list(tmp_path / "list.txt").streams
    folder = RunFolder(tmp_path / "out")
    folder.create(describe_run(streams, Config(), recorded({"save": SAVED})))
    written(tmp_path / "out/yard", source, 45)
    written(tmp_path / "out/yard", source)
    StatusFile(folder.path / "status.json").finish([StreamState("yard", "done", read=60, committed=60)], 0)
    given = ["--streams", str(tmp_path / "list.txt"), "--output", str(folder.path), "--resume"]
    ended = subprocess.run(
        [sys.executable, "-m", "orchestrator", *given],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "Drawing the overlay of yard anew" in ended.stderr
    assert [path.name for path in (tmp_path / "out/yard").glob("overlay*")] == ["overlay.mp4"]
    assert len(shown(tmp_path / "out/yard/overlay.mp4")[0]) == len(
        list(recorded_stream(tmp_path / "out/yard"))
    )
    assert 'href="yard/overlay.mp4"' in (folder.path / "report.html").read_text()
