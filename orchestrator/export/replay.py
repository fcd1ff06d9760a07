"""Replay of a recorded stream: its source read again, and segmented again to inspect the internals."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.inspection import FrameInspection
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.record.edits import NO_EDITS, Edits
from mlbs_actors.record.recorded_stream import RecordedFrame, recorded_stream
from mlbs_actors.source import SourceFrame
from mlbs_actors.subtractor import MultilayerSubtractor
from orchestrator.pictures.privacy import FRAMES_AFTER, MovingArea, blurred
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader
from orchestrator.working_size import enlarged, shrunk

__all__ = ["InspectedFrame", "inspected", "replayed", "with_pictures"]


@dataclass(frozen=True, slots=True)
class InspectedFrame:
    """A frame of the record, and the internals from labelling it again.

    Attributes
    ----------
    recorded : RecordedFrame
    inspection : FrameInspection
        In pixels of the processed picture, which may be smaller than the recorded one.
    same_labels : bool
        Whether its label map is the recorded one.
    """

    recorded: RecordedFrame
    inspection: FrameInspection
    same_labels: bool


def replayed(source: str) -> Iterator[SourceFrame]:
    """Read a source again; yield nothing for a camera, or a missing source."""
    try:
        address = parse_address(source, Path("/"))
        if address.live:
            return
        with closing(open_reader(address)) as reader:
            while isinstance(frame := reader.read(), SourceFrame):
                yield frame
    except (ConfigError, SourceError):
        return


def with_pictures(
    stream: Path, source: str, *, private: bool = False, edits: Edits | None = None
) -> Iterator[tuple[RecordedFrame, Array | None]]:
    """Pair recorded frames with the pictures of their source, None where those cannot be read again.

    Parameters
    ----------
    stream : Path
        Its folder.
    source : str
    private : bool
        Whether what moves is blurred, and pictures of another size than recorded are left out.
    edits : Edits, optional
        Corrections of ids; by default those of :func:`~mlbs_actors.record.recorded_stream.edits_of`.

    Raises
    ------
    ConfigError
        If the stream's corrections are wrong.
    """
    pairs = _with_pictures(recorded_stream(stream, edits), source)
    # What was dropped by hand moves all the same.
    return _hidden(pairs, recorded_stream(stream, NO_EDITS)) if private else pairs


def _hidden(
    pairs: Iterable[tuple[RecordedFrame, Array | None]], recorded: Iterable[RecordedFrame]
) -> Iterator[tuple[RecordedFrame, Array | None]]:
    moving, held = MovingArea(), deque[tuple[RecordedFrame, Array | None]]()

    def oldest() -> tuple[RecordedFrame, Array | None]:
        frame, picture = held.popleft()
        if picture is None or picture.shape[:2] != (frame.height, frame.width):
            return frame, None
        return frame, blurred(picture, moving.mask(len(held)))

    for (frame, picture), as_recorded in zip(pairs, recorded, strict=False):
        moving.follow(as_recorded.labels(), frame.camera)
        held.append((frame, picture))
        if len(held) > FRAMES_AFTER:
            yield oldest()
    while held:
        yield oldest()


def _with_pictures(
    frames: Iterable[RecordedFrame], source: str
) -> Iterator[tuple[RecordedFrame, Array | None]]:
    pictures = replayed(source)
    newest = next(pictures, None)
    for frame in frames:
        while newest is not None and newest.index < frame.index:
            newest = next(pictures, None)
        yield frame, newest.image if newest is not None and newest.index == frame.index else None


def inspected(
    recorded: Iterable[RecordedFrame],
    source: str,
    config: Config,
    max_frames: int | None = None,
    max_side: int | None = None,
    ignored: Array | None = None,
) -> Iterator[InspectedFrame]:
    """Segment a source as a run did, in this process.

    Parameters
    ----------
    recorded : iterable of RecordedFrame
    source : str
        Their source; if it cannot be read again nothing is yielded.
    max_frames, max_side : int, optional
    ignored : (h, w) bool, optional
        Of the run.

    Yields
    ------
    InspectedFrame
        In order, for every recorded frame that can be read again.
    """
    inspections: deque[FrameInspection] = deque()
    subtractor = MultilayerSubtractor(config, inspections.append, ignored=ignored)
    given: deque[SourceFrame] = deque()

    def results() -> Iterator[Segmentation]:
        pictures = ((frame, frame.image) for frame in replayed(source) if frame.image is not None)
        for frame, image in islice(pictures, max_frames):
            given.append(frame)
            shown = image if max_side is None else shrunk(image, max_side)
            yield from subtractor.apply(shown, concealed=frame.concealed)
        yield from subtractor.flush()

    known = iter(recorded)
    newest = next(known, None)
    for result in results():
        frame, inspection = given.popleft(), inspections.popleft()
        while newest is not None and newest.index < frame.index:
            newest = next(known, None)
        if newest is None:
            return
        if newest.index == frame.index and frame.image is not None:
            height, width = frame.image.shape[:2]
            labels = enlarged(result, (height, width)).labels
            yield InspectedFrame(newest, inspection, np.array_equal(labels, newest.labels()))
