"""A finished run over files, with objects that are known, to make things of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from record_fakes import HEIGHT, WIDTH, segmentation

from mlbs_actors.config import Config
from mlbs_actors.messages import ObjectState, Segmentation
from mlbs_actors.source import SourceFrame
from orchestrator.options import recorded
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["FRAMES", "two_objects", "write_pictures", "write_run_over"]

#: Of the folder of pictures.
FRAMES = 40

SAVED = frozenset({"parquet", "masks"})


def write_pictures(folder: Path, frames: int = FRAMES) -> Path:
    """Noise, a picture a frame, which every effect changes."""
    folder.mkdir(parents=True)
    noise = np.random.default_rng(1)
    for index in range(frames):
        picture = noise.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        cv2.imwrite(str(folder / f"img{index:03d}.png"), picture)
    return folder


def two_objects(index: int) -> Segmentation:
    """Object 5 moves from frame 10 to 29 only; 3 always does, and has the better score."""
    made = segmentation(index, 3, 5)
    three, five = made.layers
    state: ObjectState = "moving" if 10 <= index < 30 else "resting"
    return replace(made, layers=(replace(three, score=0.9, area=80), replace(five, score=0.2, state=state)))


def write_run_over(
    run: Path, sources: Mapping[str, Path | str], found: Callable[[int], Segmentation] = two_objects
) -> Path:
    """Record streams of files as if the engine had found these objects in every frame."""
    streams, states = [], []
    for line, (name, source) in enumerate(sources.items(), start=1):
        address = parse_address(str(source), run)
        record = StreamRecord(run / name, name, SAVED)
        if not address.live:
            reader = open_reader(address)
            while isinstance(frame := reader.read(), SourceFrame):
                record.write(found(frame.index), frame)
        committed = record.close(whole=True)
        streams.append(ListedStream(name, address, line))
        states.append(StreamState(name, "done", read=committed, committed=committed))
    RunFolder(run).create(describe_run(streams, Config(), recorded({"save": SAVED})))
    StatusFile(run / "status.json").finish(states, 0)
    return run
