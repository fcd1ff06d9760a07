"""A record that hands its results over: after their commit, and again only what was not committed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from thread_host import threads

from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.processes import get, here, spawn
from mlbs_actors.actors.stream.protocol import Opening, Snapshot
from mlbs_actors.messages import LayerAppearance, Segmentation
from mlbs_actors.source import GapStatus, SourceFrame
from orchestrator.library.delivered_record import DeliveredRecord
from orchestrator.library.result import StreamResult
from orchestrator.library.result_queue import ResultQueue


class PlainRecord:
    """Counts; a file's rows are committed after every eighth frame, a camera's with a snapshot."""

    def __init__(self, *, live: bool = False, before: Snapshot | None = None) -> None:
        self.opening = Opening(None, before)
        self._live = live
        self._written = self._committed = 0 if before is None else before.label_maps

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        self._written += 1
        if not self._live and (frame.index + 1) % 8 == 0:
            self._committed = self._written
        return self._committed

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        return self._committed

    def silent(self) -> None:
        """Do nothing."""

    def configure(self, settings: object) -> None:
        """Do nothing."""

    def keep(self, snapshot: Snapshot) -> bool:
        if self._live:
            self._committed = snapshot.label_maps
        return True

    def provisional(self) -> None:
        """Do nothing."""

    def close(self, *, whole: bool) -> int:
        self._committed = self._written
        return self._committed


@pytest.fixture
def queue() -> Iterator[Handle]:
    with threads():
        yield spawn(ResultQueue, node=here())


def write(record: DeliveredRecord, index: int) -> int:
    labels = np.full((2, 3), index, np.uint16)
    cells = np.zeros((1, 1), np.int8)
    segmentation = Segmentation(index, labels, cells.view(np.uint8), cells, (), (0.0, 0.0), 0)
    frame = SourceFrame(index, np.zeros((2, 3, 3), np.uint8), index / 25, f"{index:05d}")
    return record.write(segmentation, frame)


def frames_in(queue: Handle) -> list[int]:
    results: list[StreamResult] = get(queue.take.remote(100, 0.0))
    assert all((one.labels == one.frame).all() for one in results)
    return [one.frame for one in results]


def test_results_of_a_file_are_there_after_their_commit_and_the_rest_at_its_end(queue: Handle) -> None:
    record = DeliveredRecord(PlainRecord, "a", queue)
    for index in range(7):
        write(record, index)
    assert frames_in(queue) == []
    for index in range(7, 10):
        write(record, index)
    assert frames_in(queue) == list(range(8))
    assert record.close(whole=True) == 10
    assert frames_in(queue) == [8, 9]


def test_a_snapshot_of_a_file_commits_nothing_and_one_of_a_camera_what_is_before_it(
    queue: Handle, tmp_path: Path
) -> None:
    snapshot = Snapshot(tmp_path, 3, 3, ())
    for name, live in (("file", False), ("camera", True)):
        record = DeliveredRecord(partial(PlainRecord, live=live), name, queue, live=live)
        for index in range(5):
            write(record, index)
        assert record.keep(snapshot)
        assert frames_in(queue) == ([0, 1, 2] if live else [])


def test_a_record_opened_again_hands_over_only_what_is_new(queue: Handle, tmp_path: Path) -> None:
    first = DeliveredRecord(PlainRecord, "a", queue)
    for index in range(12):
        write(first, index)
    assert frames_in(queue) == list(range(8))
    before = replace(Snapshot(tmp_path, 0, 0, ()), rows=4, label_maps=4)
    second = DeliveredRecord(partial(PlainRecord, before=before), "a", queue)
    for index in range(4, 16):
        write(second, index)
    assert frames_in(queue) == list(range(8, 16))
