"""What streams must produce whatever happens: their frames, labelled one after the other in this process."""

from __future__ import annotations

import shlex
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path
from threading import Lock
from typing import Any

from chaos.harness.observed_run import content
from mlbs_actors import MultilayerSubtractor
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.source import SourceFrame
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["References", "label_in_process"]


class References:
    """Contents of undisturbed streams; each is labelled once, when it is first requested.

    Parameters
    ----------
    folder : Path
        For their records.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[tuple[str, str], dict[str, Any]] = {}
        self._lock = Lock()

    def of(self, line: str, folder: Path) -> dict[str, Any]:
        """Return the :func:`content` of the stream of a list's line, whose path is relative to ``folder``."""
        name, uri = shlex.split(line)
        source = parse_address(uri, folder)
        with self._lock:
            if (name, str(source)) not in self._known:
                record = self._folder / f"{len(self._known)}" / name
                _label(source, record)
                self._known[name, str(source)] = content(record)
            return self._known[name, str(source)]


def label_in_process(pictures: Sequence[Array]) -> list[Array]:
    """Label pictures, (H, W, 3) uint8 each, in this process; return a label map for each."""
    subtractor = MultilayerSubtractor()
    results = [result for picture in pictures for result in subtractor.apply(picture)]
    return [result.labels for result in [*results, *subtractor.flush()]]


def _label(source: SourceAddress, folder: Path) -> None:
    reader = open_reader(source)
    record = StreamRecord(folder, folder.name, frozenset({"masks", "parquet"}))
    subtractor = MultilayerSubtractor()
    waiting: deque[SourceFrame] = deque()  # read, and neither labelled nor recorded as a gap

    def write(results: Iterable[Segmentation]) -> None:
        for result in results:
            record.write(result, waiting.popleft())
            write_gaps()

    def write_gaps() -> None:
        while waiting and (status := waiting[0].status) != "ok":
            frame = waiting.popleft()
            record.gap(frame.index, frame.pts, status)

    while (frame := reader.read()) is not None:
        assert isinstance(frame, SourceFrame)  # no camera
        waiting.append(frame)
        if frame.image is None:
            write_gaps()
        else:
            write(subtractor.apply(frame.image, concealed=frame.concealed))
    write(subtractor.flush())
    record.close(whole=True)
    reader.close()
