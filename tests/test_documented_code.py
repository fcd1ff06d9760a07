"""The Python of the documentation runs as it stands there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from paced_camera import PacedCamera
from record_fakes import write_run

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages take as given: ``street.mp4``, the run ``out`` over it, a DAVIS tree."""
    folder = tmp_path_factory.mktemp("notebook")
    street = scene("demo", width=160, height=120, frames=FRAMES)
    video = cv2.VideoWriter(str(folder / "street.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25, (160, 120), True)
    for index in range(FRAMES):
        video.write(street.frame(index))
        for kind, ending, picture in (
            ("JPEGImages", "jpg", street.frame(index)),
            ("Annotations", "png", street.labels(index)),
        ):
            path = folder / f"DAVIS/{kind}/480p/street/{index:05d}.{ending}"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), picture)
    video.release()
    record = StreamRecord(folder / "out/street", "street", frozenset({"masks", "parquet"}))
    subtractor = MultilayerSubtractor()
    reader = cv2.VideoCapture(str(folder / "street.mp4"))
    pictures = [picture for there, picture in (reader.read() for _ in range(FRAMES)) if there]
    results = [result for picture in pictures for result in subtractor.apply(picture)] + subtractor.flush()
    for result in results:
        index = result.frame_index
        record.write(result, SourceFrame(index, pictures[index], index / 25, f"{index:05d}"))
    committed = record.close(whole=True)
    write_run(folder / "out", [StreamState("street", "done", read=FRAMES, committed=committed)])
    return folder


def python_blocks(text: str) -> list[re.Match[str]]:
    """The Python of a page, as group 1 of each."""
    return list(re.finditer(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE))


# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.long
@pytest.mark.parametrize("page", ["README.md", "docs/python_api.md", "docs/research.md"])
def test_the_code_of_a_page_runs_block_by_block(
    page: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    street, opened = scene("demo", width=160, height=120, frames=FRAMES), cv2.VideoCapture

    def open_video(source: str | int) -> object:
        if source != 0:
            return opened(source)
        camera = PacedCamera([street.frame(index) for index in range(FRAMES)])
        camera.let_arrive(FRAMES + 1)
        return camera

    monkeypatch.setattr(cv2, "VideoCapture", open_video)
    text = (ROOT / page).read_text(encoding="utf-8")
    names: dict[str, object] = {"__name__": "__main__"}
    for block in python_blocks(text):
        if "import supervision" in block[1] and find_spec("supervision") is None:
            continue  # with Python 3.10 it would replace OpenCV
        if re.search("^import (torch|trackeval)$", block[1], re.MULTILINE):
            continue  # one downloads a network, the other is no dependency
        lines_before = text.count("\n", 0, block.start(1))
        # So that a traceback names the line of the page.
        exec(compile("\n" * lines_before + block[1], ROOT / page, "exec"), names)
    assert len(names) > 5


@pytest.mark.ray
@pytest.mark.long
def test_the_code_of_the_page_on_ray_runs_as_one_program(folder: Path) -> None:
    for number in range(2):
        (folder / "clips").mkdir(exist_ok=True)
        shutil.copy(folder / "street.mp4", folder / f"clips/clip{number}.mp4")
    blocks = [block[1] for block in python_blocks((ROOT / "docs/ray.md").read_text(encoding="utf-8"))]
    assert len(blocks) == 5
    missing = [
        package
        for package, needed in (("ray.data", "pandas"), ("serve", "fastapi"))
        if find_spec(needed) is None
    ]
    program = "\n".join(one for one in blocks if not any(f"import {package}" in one for package in missing))
    # What a block without its package would have brought.
    program = "from typing import Any\nfrom mlbs_actors import MultilayerSubtractor\n" + program
    (folder / "program.py").write_text(program, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "program.py"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "gate 9 0.36 (120, 160)" in done.stdout
    assert "{'gate': ('done', None), 'yard': ('done', None)}" in done.stdout


@pytest.fixture(scope="module")
def newest_frames() -> Callable[[PacedCamera], Generator[tuple[float, Array], None, None]]:
    """The documented function of this name."""
    text = (ROOT / "docs/python_api.md").read_text(encoding="utf-8")
    (block,) = (one[1] for one in python_blocks(text) if "def newest_frames" in one[1])
    names: dict[str, Any] = {}
    exec(block, names)
    found: Callable[[PacedCamera], Generator[tuple[float, Array], None, None]] = names["newest_frames"]
    return found


def test_a_slow_reader_of_a_camera_gets_its_newest_frames_in_order(
    newest_frames: Callable[[PacedCamera], Generator[tuple[float, Array], None, None]],
) -> None:
    camera = PacedCamera([np.full((2, 2, 3), index, np.uint8) for index in range(100)])
    frames = newest_frames(camera)
    seen: list[int] = []
    for meanwhile in (1, 10, 1, 60, 28):  # as many arrive while the reader is busy
        camera.let_arrive(meanwhile)
        if seen:  # before, nobody reads the camera
            camera.wait_until_taken()
        seen.append(int(next(frames)[1][0, 0, 0]))
    assert seen == [0, 10, 11, 71, 99]
    camera.let_arrive(1)
    assert list(frames) == []
    assert camera.released


def test_a_reader_that_stops_releases_the_camera_and_its_thread_ends(
    newest_frames: Callable[[PacedCamera], Generator[tuple[float, Array], None, None]],
) -> None:
    threads = threading.active_count()
    camera = PacedCamera(np.broadcast_to(np.zeros(3, np.uint8), (10**9, 2, 2, 3)))
    camera.let_arrive(10**9)
    frames = newest_frames(camera)
    next(frames)
    frames.close()
    assert camera.released
    assert threading.active_count() == threads
