"""Results and whole runs made up for the tests of what is written and read back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mlbs_actors.actors.stream.protocol import Snapshot
from mlbs_actors.config import Config
from mlbs_actors.messages import LayerSummary, Region, Segmentation
from mlbs_actors.source import SourceFrame
from orchestrator.options import recorded
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address

HEIGHT, WIDTH = 36, 50
EVERYTHING = frozenset({"masks", "parquet", "overlay"})


def bare_snapshot(record: StreamRecord, rows: int) -> Snapshot:
    """A snapshot after so many rows, whose files are complete."""
    assert record.opening.snapshots is not None
    folder = record.opening.snapshots / f"{rows:08d}"
    folder.mkdir(parents=True)
    (folder / "part").write_bytes(b"")
    return Snapshot(folder, rows, rows, ())


def segmentation(index: int, layer: int = 3, *more: int) -> Segmentation:
    """Objects one below the other that move a pixel a frame."""
    labels = np.zeros((HEIGHT, WIDTH), np.uint16)
    x, summaries = index % 30, []
    for number, one in enumerate((layer, *more)):
        y = 5 + 12 * number
        labels[y : y + 10, x : x + 8] = one
        summaries.append(
            LayerSummary(
                layer=one,
                kind="object",
                region=Region(x, y, 8, 10),
                area=80,
                centroid=(x + 3.5, y + 4.5),
                velocity=(1.0, 0.0),
                confidence=0.75,
                score=0.5,
            )
        )
    return Segmentation(
        frame_index=index,
        labels=labels,
        normaliser=np.zeros_like(labels, np.uint8),
        fallback=np.zeros_like(labels, np.int8),
        layers=tuple(summaries),
        camera_motion=(0.5, -0.25),
        latency_frames=1,
        stage_ms={"track": 2.0, "cut": 3.0},
    )


def frame(index: int) -> SourceFrame:
    """A grey picture at ten a second."""
    image = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    return SourceFrame(index, image, index / 10, f"img{index:03d}")


def write_stream(folder: Path, save: frozenset[str] = EVERYTHING) -> StreamState:
    """A stream of 40 frames: frame 10 cannot be decoded; object 5 is hidden in frames 20 to 24."""
    record = StreamRecord(folder, folder.name, save)
    for index in range(40):
        if index == 10:
            record.gap(index, index / 10, "quarantined")
        elif 20 <= index < 25:
            record.write(segmentation(index, 3), frame(index))
        else:
            record.write(segmentation(index, 3, 5), frame(index))
    committed = record.close(whole=True)
    error = "1 frame could not be decoded."
    return StreamState(folder.name, "partial", read=40, committed=committed, quarantined=1, error=error)


def write_run(folder: Path, states: Sequence[StreamState]) -> None:
    """The files of a run over these streams, ended with status 1."""
    streams = [
        ListedStream(state.name, parse_address("rtsp://bob:hunter2@cam/x", folder), 1) for state in states
    ]
    command = ["python", "-m", "orchestrator", "--streams", "/a b/list.txt"]
    RunFolder(folder).create(describe_run(streams, Config(), recorded({"save": EVERYTHING}), command))
    StatusFile(folder / "status.json").finish(states, 1)
