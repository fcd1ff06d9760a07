"""The label maps of a sequence: from the engine in this process, or from the masks of a finished run."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Protocol

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.record.record_tables import read_rows
from mlbs_actors.stored_motion import StoredMotion
from orchestrator.evaluation import sequences
from orchestrator.storage.segments import archived_masks
from orchestrator.working_size import labels_in_size, resized

__all__ = ["EngineLabelling", "ResizingSubtractor", "Subtractor", "run_label_maps", "run_scores"]


class Subtractor(Protocol):
    """Labels frames: the engine, or a similar object."""

    def apply(self, frame: Array) -> Sequence[Segmentation]:
        """Take the next frame; return the frames that are now labelled."""

    def flush(self) -> Sequence[Segmentation]:
        """Return the frames still held."""


class ResizingSubtractor:
    """A subtractor that works on pictures of another size.

    Parameters
    ----------
    subtractor : Subtractor
    longer_side : int
        Of the pictures that it is given, px.
    """

    def __init__(self, subtractor: Subtractor, longer_side: int) -> None:
        self._subtractor = subtractor
        self._longer_side = longer_side
        self._shape = (0, 0)

    def apply(self, frame: Array) -> list[Segmentation]:
        """Take the next frame; return the frames that are now labelled, with labels only."""
        self._shape = (frame.shape[0], frame.shape[1])
        return self._in_size(self._subtractor.apply(resized(frame, self._longer_side)))

    def flush(self) -> list[Segmentation]:
        """Return the frames still held."""
        return self._in_size(self._subtractor.flush())

    def _in_size(self, results: Sequence[Segmentation]) -> list[Segmentation]:
        return [replace(one, labels=labels_in_size(one.labels, self._shape), layers=()) for one in results]


@dataclass(slots=True)
class EngineLabelling:
    """Label maps of a sequence from the engine, by frame index, and their cost so far.

    Attributes
    ----------
    sequence : Sequence
    subtractor : Subtractor
        Fresh: no frame seen yet.
    motion : StoredMotion or None
        Is told of every frame before the subtractor is.
    frames : int
        Label maps so far.
    milliseconds : float
        Wall time spent in the engine so far, ms.
    cpu_milliseconds : float
        CPU time, ms.
    stage_ms : defaultdict of str to float
        Wall time by stage, as reported by the segmentations.
    scores : dict of int to dict of int to float
        Frame index → label → score of its mask.
    """

    sequence: sequences.Sequence
    subtractor: Subtractor
    motion: StoredMotion | None = None
    frames: int = 0
    milliseconds: float = 0.0
    cpu_milliseconds: float = 0.0
    stage_ms: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    scores: dict[int, dict[int, float]] = field(default_factory=dict)

    def __iter__(self) -> Iterator[tuple[int, Array]]:
        for index, stem in enumerate(self.sequence.stems):
            frame = self.sequence.frame(index)
            if self.motion is not None:
                self.motion.follow(index, stem, frame)
            yield from self._timed(self.subtractor.apply, frame)
        yield from self._timed(self.subtractor.flush)

    def _timed(
        self, step: Callable[..., Sequence[Segmentation]], *frame: Array
    ) -> Iterator[tuple[int, Array]]:
        started, cpu_started = time.perf_counter(), time.process_time()
        segmentations = step(*frame)
        self.milliseconds += 1000 * (time.perf_counter() - started)
        self.cpu_milliseconds += 1000 * (time.process_time() - cpu_started)
        for segmentation in segmentations:
            self.frames += 1
            for stage, milliseconds in segmentation.stage_ms.items():
                self.stage_ms[stage] += milliseconds
            index = segmentation.frame_index
            self.scores[index] = {one.layer: one.score for one in segmentation.layers}
            yield index, segmentation.labels


def run_label_maps(sequence: sequences.Sequence, masks: Path) -> Iterator[tuple[int, Array]]:
    """Read the masks of a run, by frame index; skip frames without a mask.

    ``masks`` is the folder of that name in a stream's folder, which has segments instead if it was a camera.

    Raises
    ------
    SourceError
        If the folder is missing, no mask has the stem of a frame, or a mask cannot be read.
    """
    archived = archived_masks(masks.parent)
    if not masks.is_dir() and not archived:
        raise SourceError(f"{masks} is no folder; name the stream as the run's list did.")
    present = {path.stem for path in masks.glob("*.png")} | archived.keys()
    indices = [index for index, stem in enumerate(sequence.stems) if stem in present]
    if not indices:
        raise SourceError(
            f"No mask in {masks} has the stem of a frame of {sequence.name}; check the folder of the truth."
        )
    for index in indices:
        stem = sequence.stems[index]
        mask = BytesIO(archived[stem].read()) if stem in archived else masks / f"{stem}.png"
        yield index, sequences.read_label_map(mask)


def run_scores(sequence: sequences.Sequence, stream: Path) -> dict[int, dict[int, float]]:
    """Read the scores of a run's masks: frame index → label → score; empty if its tables were not saved.

    Parameters
    ----------
    sequence : Sequence
    stream : Path
        The stream's folder.
    """
    indices = {stem: index for index, stem in enumerate(sequence.stems)}
    return {
        indices[row.name]: {layer.layer: layer.score for layer in row.result.layers}
        for row in read_rows(stream)
        if row.result is not None and row.name in indices
    }
