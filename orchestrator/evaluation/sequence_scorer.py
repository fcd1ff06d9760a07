"""All figures of one sequence, collected frame by frame: means by range of frames, and layers off the truth.

Differs from the paper: it adds ``j`` and the boundary measure ``f`` of DAVIS, ``object_f`` and
``extra_layers``, which separate lost objects from layers that the truth does not have, ``track_j`` and
``ids_on``, which say whether an object keeps its label, and scores the frames of the start separately.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array, Region
from orchestrator.evaluation.frame_statistics import frame_statistics
from orchestrator.evaluation.metrics import (
    false_area,
    jaccard,
    match_objects,
    multi_label,
    multi_label_matlab,
    object_level,
    two_label,
)
from orchestrator.evaluation.overlap import FrameOverlap, count_overlap, ious_of
from orchestrator.evaluation.track_metrics import (
    TrackScore,
    davis_tracks,
    entry_delays,
    id_switches,
    ids_on,
    moving_objects,
    shared_ids,
    track_j,
)

__all__ = ["START_FRAMES", "ExtraLayer", "FrameScore", "RangeScore", "SequenceScore", "SequenceScorer"]

#: Most frames held until the first clustering; "after the start" begins after them.
START_FRAMES = 5

MIN_EXTRA_LIFE = 3  # frames a layer must live to count as extra


@dataclass(frozen=True, slots=True)
class ExtraLayer:
    """A layer mostly off all truth objects: a real mover that the truth leaves out, or a false one.

    Attributes
    ----------
    layer : int
        Label id.
    first_frame, frames : int
        The frame it was first seen in, and in how many it was seen.
    on_truth : float
        Share of its judged pixels that lie on truth objects, in [0, 0.5).
    example_frame : int
        The frame in which it was largest.
    region : Region
        Its bounding box there.
    mask : (region.height, region.width) bool
        Its pixels there.
    """

    layer: int
    first_frame: int
    frames: int
    on_truth: float
    example_frame: int
    region: Region
    mask: Array


@dataclass(frozen=True, slots=True)
class RangeScore:
    """Means over the frames with truth of one range of a sequence; NaN where no frame counts.

    ``precision``, ``recall``, ``two_label_f``, ``j``, ``f`` and ``false_area``, the share of the judged
    pixels that are labelled but background, are means over all of them, the others over those whose truth has
    objects: ``multi_precision``, ``multi_recall`` and ``multi_f`` as the paper's text
    has them, the same with ``_matlab`` as the authors' program does. ``j_recall``, ``j_decay`` and so on are
    those of :mod:`orchestrator.evaluation.frame_statistics`. All in [0, 1], a decay in [−1, 1].
    """

    frames: int
    precision: float
    recall: float
    two_label_f: float
    j: float
    j_recall: float
    j_decay: float
    f: float
    f_recall: float
    f_decay: float
    false_area: float
    multi_precision: float
    multi_recall: float
    multi_f: float
    object_f: float
    multi_precision_matlab: float
    multi_recall_matlab: float
    multi_f_matlab: float

    @property
    def j_and_f(self) -> float:
        """Mean of ``j`` and ``f``."""
        return (self.j + self.f) / 2


@dataclass(frozen=True, slots=True)
class FrameScore:
    """The figures of one frame with truth, in [0, 1].

    Attributes
    ----------
    index : int
        Frame index.
    j, f, two_label_f : float
        Intersection over union, boundary measure F, and F, of moving against not moving.
    object_f : float
        F of every object on its own; NaN without objects.
    labels : tuple of int
        Label ids, ascending.
    matches : mapping of int to int or None
        Truth id → the label that fits it best in this frame, None: lost.
    ious : mapping of int to float
        Label → intersection over union with the truth object that it fits best; 0 off all of them.
    """

    index: int
    j: float
    f: float
    two_label_f: float
    object_f: float
    labels: tuple[int, ...]
    matches: Mapping[int, int | None]
    ious: Mapping[int, float]


def _frame_score(overlap: FrameOverlap) -> FrameScore:
    matches = match_objects(overlap)
    return FrameScore(
        index=overlap.index,
        j=jaccard(overlap),
        f=overlap.boundary_f,
        two_label_f=two_label(overlap).f,
        object_f=object_level(overlap).f if len(overlap.objects) else float("nan"),
        labels=tuple(overlap.labels.tolist()),
        matches={truth_id: matches.get(truth_id) for truth_id in overlap.objects.tolist()},
        ious=dict(
            zip(overlap.labels.tolist(), ious_of(overlap).max(axis=0, initial=0.0).tolist(), strict=True)
        ),
    )


@dataclass(frozen=True, slots=True)
class SequenceScore:
    """All figures of one sequence.

    Attributes
    ----------
    frames : int
        Labelled frames, with or without truth.
    all_frames, first_ten, after_start, davis : RangeScore
        Frames with truth: all; with index below ten; from index ``START_FRAMES`` on; without the first and
        the last of them (DAVIS's own protocol).
    per_frame : tuple of FrameScore
        The frames with truth, one by one.
    track_j : float
        How well one label stays on each object, in [0, 1]; NaN where the truth has no object.
    davis_tracks : tuple of TrackScore
        The same question as DAVIS 2017's unsupervised task asks it, for each object.
    extra_layers : float
        Extra layers per 100 labelled frames.
    extras : tuple of ExtraLayer
        The same, one by one, in ascending id.
    ids_on : float
        Labels on a truth object, mean over the objects; NaN where the truth has none.
    shared_ids : float
        Share of the found objects of all frames that have their label in common with another one, in [0, 1];
        NaN where none is found.
    id_switches : int
    entry_delay : mapping of int to int or None
        Frames from an object's entry until it is found, by truth id; None: never found. Objects there from
        the start enter with frame 1. Empty when the exact motion is not known.
    """

    frames: int
    all_frames: RangeScore
    first_ten: RangeScore
    after_start: RangeScore
    davis: RangeScore
    per_frame: tuple[FrameScore, ...]
    track_j: float
    davis_tracks: tuple[TrackScore, ...]
    extra_layers: float
    extras: tuple[ExtraLayer, ...]
    ids_on: float
    shared_ids: float
    id_switches: int
    entry_delay: Mapping[int, int | None]


def _score_range(overlaps: Sequence[FrameOverlap]) -> RangeScore:
    binary = [two_label(overlap) for overlap in overlaps]
    with_objects = [overlap for overlap in overlaps if len(overlap.objects)]
    multi = [multi_label(overlap) for overlap in with_objects]
    matlab = [multi_label_matlab(overlap) for overlap in with_objects]
    j = frame_statistics([jaccard(overlap) for overlap in overlaps])
    f = frame_statistics([overlap.boundary_f for overlap in overlaps])
    return RangeScore(
        frames=len(overlaps),
        precision=_mean(agreement.precision for agreement in binary),
        recall=_mean(agreement.recall for agreement in binary),
        two_label_f=_mean(agreement.f for agreement in binary),
        j=j.mean,
        j_recall=j.recall,
        j_decay=j.decay,
        f=f.mean,
        f_recall=f.recall,
        f_decay=f.decay,
        false_area=_mean(false_area(overlap) for overlap in overlaps),
        multi_precision=_mean(agreement.precision for agreement in multi),
        multi_recall=_mean(agreement.recall for agreement in multi),
        multi_f=_mean(agreement.f for agreement in multi),
        object_f=_mean(object_level(overlap).f for overlap in with_objects),
        multi_precision_matlab=_mean(agreement.precision for agreement in matlab),
        multi_recall_matlab=_mean(agreement.recall for agreement in matlab),
        multi_f_matlab=_mean(agreement.f for agreement in matlab),
    )


def _mean(values: Iterable[float]) -> float:
    collected = list(values)
    return sum(collected) / len(collected) if collected else float("nan")


@dataclass(slots=True)
class _Life:
    """Statistics of one label id so far."""

    first_frame: int
    frames: int = 0
    judged: int = 0
    on_truth: int = 0
    largest: int = 0
    example_frame: int = 0
    region: Region = Region(0, 0, 0, 0)  # noqa: RUF009 - Region is immutable
    mask: Array | None = None


class SequenceScorer:
    """Collects one sequence's label maps, frame by frame in ascending index, and scores them.

    Examples
    --------
    >>> import numpy as np
    >>> scorer = SequenceScorer()
    >>> scorer.add(0, np.array([[0, 7]]), np.array([[0, 1]], np.uint8))
    >>> scorer.score().all_frames.two_label_f
    1.0
    """

    def __init__(self) -> None:
        self._frames = 0
        self._overlaps: list[FrameOverlap] = []
        self._lives: dict[int, _Life] = {}
        self._entries: dict[int, int] = {}

    def add(self, index: int, labels: Array, truth: Array | None, flow: Array | None = None) -> None:
        """Take one labelled frame.

        Parameters
        ----------
        index : int
            Frame index.
        labels : (H, W) integer, ≥ 0
        truth : (H, W) uint8 or None
            None: this frame has no truth; it counts for the life of layers only.
        flow : (H, W, 2) float32 or None
            Exact motion, px/frame, when known: from it come the entries of :func:`entry_delays`.

        Raises
        ------
        FrameError
            If labels and truth differ in size.
        """
        self._frames += 1
        areas = np.bincount(labels.ravel())
        for label in (np.flatnonzero(areas[1:]) + 1).tolist():
            life = self._lives.setdefault(label, _Life(first_frame=index))
            life.frames += 1
            if areas[label] > life.largest:
                life.largest, life.example_frame = int(areas[label]), index
                life.region, life.mask = _cut_out(labels == label)
        if truth is None:
            return
        overlap = count_overlap(labels, truth, index)
        self._overlaps.append(overlap)
        for column, label in enumerate(overlap.labels.tolist(), start=1):
            self._lives[label].judged += int(overlap.counts[:, column].sum())
            self._lives[label].on_truth += int(overlap.counts[1:, column].sum())
        if flow is not None:
            for truth_id in moving_objects(truth, flow):
                self._entries.setdefault(truth_id, index)

    def score(self) -> SequenceScore:
        """Compute all figures of the frames so far."""
        extras = tuple(self._extras())
        return SequenceScore(
            frames=self._frames,
            all_frames=_score_range(self._overlaps),
            first_ten=_score_range([overlap for overlap in self._overlaps if overlap.index < 10]),
            after_start=_score_range([o for o in self._overlaps if o.index >= START_FRAMES]),
            davis=_score_range(self._overlaps[1:-1]),
            per_frame=tuple(map(_frame_score, self._overlaps)),
            track_j=track_j(self._overlaps),
            davis_tracks=tuple(davis_tracks(self._overlaps)),
            extra_layers=100.0 * len(extras) / self._frames if self._frames else 0.0,
            extras=extras,
            ids_on=ids_on(self._overlaps),
            shared_ids=shared_ids(self._overlaps),
            id_switches=id_switches(self._overlaps),
            entry_delay=entry_delays(self._overlaps, self._entries),
        )

    def _extras(self) -> Iterable[ExtraLayer]:
        for label, life in sorted(self._lives.items()):
            if life.frames < MIN_EXTRA_LIFE or life.judged == 0 or 2 * life.on_truth >= life.judged:
                continue
            assert life.mask is not None
            yield ExtraLayer(
                label,
                life.first_frame,
                life.frames,
                life.on_truth / life.judged,
                life.example_frame,
                life.region,
                life.mask,
            )


def _cut_out(mask: Array) -> tuple[Region, Array]:
    """Return the bounding box of a mask and the mask inside it."""
    region = Region(*cv2.boundingRect(mask.astype(np.uint8)))
    return region, mask[region.slices].copy()
