"""The Python of the documentation runs as it stands there."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import cv2
import pytest
from record_fakes import write_run

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.actors.stream.protocol import SourceFrame
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.synthetic import scene

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


# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("page", ["README.md", "docs/python_api.md", "docs/research.md"])
def test_the_code_of_a_page_runs_block_by_block(
    page: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    text = (ROOT / page).read_text(encoding="utf-8")
    names: dict[str, object] = {"__name__": "__main__"}
    for block in re.finditer(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        if "import supervision" in block[1] and find_spec("supervision") is None:
            continue  # with Python 3.10 it would replace OpenCV
        if re.search("^import (torch|trackeval)$", block[1], re.MULTILINE):
            continue  # one downloads a network, the other is no dependency
        lines_before = text.count("\n", 0, block.start(1))
        # So that a traceback names the line of the page.
        exec(compile("\n" * lines_before + block[1], ROOT / page, "exec"), names)
    assert len(names) > 5
