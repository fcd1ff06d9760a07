"""How well label maps agree with truth: two-label and multi-label figures, extra layers, identity, delay.

Every figure is a function of one small table a frame, the pixel counts of each (truth object, label) pair
(:class:`FrameOverlap`), so a sequence is scored while it runs and no label map is kept.

Truth: 0 = background, 1 … 254 = objects, 255 = not judged; such pixels belong to no region of either side.

Differs from the paper: the paper's multi-label figure (``multi_f``) counts every extra region as a failure,
also a real small mover that the truth leaves out. ``object_f`` leaves the extra regions out and
``extra_layers`` counts them beside it. ``multi_f_matlab`` follows the authors' program, which weighs the
objects of a frame by (P + R)².
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array, Region

__all__ = [
    "IGNORE",
    "START_FRAMES",
    "Agreement",
    "ExtraLayer",
    "FrameOverlap",
    "RangeScore",
    "SequenceScore",
    "SequenceScorer",
    "count_overlap",
    "entry_delays",
    "id_switches",
    "jaccard",
    "match_objects",
    "moving_objects",
    "multi_label",
    "multi_label_matlab",
    "object_level",
    "two_label",
]

#: Truth value of the pixels that are not judged.
IGNORE = 255
#: Frames held until the first clustering (at most); "after the start" begins behind them.
START_FRAMES = 5

MIN_EXTRA_LIFE = 3  # frames a layer must live to count as extra
MIN_ENTRY_AREA = 400  # visible px from which an object counts as entered
MIN_ENTRY_SPEED = 1.0  # px/frame against its surroundings
SURROUNDINGS = 12  # width of the ring around an object that counts as its surroundings, px
FOUND_IOU = 0.5


class Agreement(NamedTuple):
    """Precision, recall and F of one frame, each in [0, 1]."""

    precision: float
    recall: float
    f: float


@dataclass(frozen=True, slots=True)
class FrameOverlap:
    """Pixel counts of every pair of a truth object and a label in one frame.

    Attributes
    ----------
    index : int
        Frame index.
    objects : (g,) int64
        Truth ids present, ascending, without the background.
    labels : (l,) int64
        Label ids present, ascending, without the background.
    counts : (1 + g, 1 + l) int64
        Judged pixels with that truth (row) and that label (column), px; row and column 0 are the background.
    """

    index: int
    objects: Array
    labels: Array
    counts: Array


@dataclass(frozen=True, slots=True)
class ExtraLayer:
    """A layer that lies mostly off every truth object: a real mover the truth leaves out, or a false one.

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

    ``precision``, ``recall``, ``two_label_f`` and ``j`` are means over all of them, ``multi_f``, ``object_f``
    and ``multi_f_matlab`` over those whose truth has objects. All in [0, 1].
    """

    frames: int
    precision: float
    recall: float
    two_label_f: float
    j: float
    multi_f: float
    object_f: float
    multi_f_matlab: float


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
    extra_layers : float
        Extra layers per 100 labelled frames.
    extras : tuple of ExtraLayer
        The same, one by one, in ascending id.
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
    extra_layers: float
    extras: tuple[ExtraLayer, ...]
    id_switches: int
    entry_delay: Mapping[int, int | None]


def count_overlap(labels: Array, truth: Array, index: int = 0) -> FrameOverlap:
    """Count the judged pixels of every (truth object, label) pair.

    Parameters
    ----------
    labels : (H, W) integer, ≥ 0
        Label map to be judged, 0 = background.
    truth : (H, W) uint8
        0 = background, 255 = not judged.
    index : int
        Frame index, kept in the result.

    Raises
    ------
    FrameError
        If the two differ in size.
    """
    if labels.shape != truth.shape:
        raise FrameError(
            f"frame {index}: the label map is {labels.shape} and the truth {truth.shape} (rows, columns); "
            "score masks at the size of their truth"
        )
    judged = truth != IGNORE
    object_ids, object_rank = _ranks(truth[judged])
    label_ids, label_rank = _ranks(labels[judged])
    joint = object_rank * len(label_ids) + label_rank
    counts = np.bincount(joint, minlength=len(object_ids) * len(label_ids))
    return FrameOverlap(index, object_ids[1:], label_ids[1:], counts.reshape(len(object_ids), len(label_ids)))


def _ranks(values: Array) -> tuple[Array, Array]:
    """The ids present (0 always among them, ascending) and each value's position among them."""
    present = np.bincount(values, minlength=1) > 0
    present[0] = True
    ids = np.flatnonzero(present)
    rank = np.cumsum(present) - 1
    return ids, rank[values]


def two_label(overlap: FrameOverlap) -> Agreement:
    """Moving against still, whatever the label: nothing on both sides scores 1, on one side F = 0."""
    counts = overlap.counts
    both = int(counts[1:, 1:].sum())
    found, true = int(counts[:, 1:].sum()), int(counts[1:].sum())
    if found == 0 and true == 0:
        return Agreement(1.0, 1.0, 1.0)
    precision = both / found if found else 1.0
    recall = both / true if true else 1.0
    return Agreement(precision, recall, 2 * both / (found + true))


def jaccard(overlap: FrameOverlap) -> float:
    """Intersection over union of moving pixels; nothing on both sides scores 1."""
    counts = overlap.counts
    union = int(counts.sum() - counts[0, 0])
    return float(counts[1:, 1:].sum() / union) if union else 1.0


def _region_scores(overlap: FrameOverlap) -> tuple[Array, Array, Array]:
    """Precision, recall and F of every (object, label) pair: three (g, l) float64 arrays."""
    counts = overlap.counts
    inside = counts[1:, 1:]
    label_area = counts[:, 1:].sum(axis=0)[None, :]
    object_area = counts[1:].sum(axis=1)[:, None]
    return inside / label_area, inside / object_area, 2 * inside / (label_area + object_area)


def match_objects(overlap: FrameOverlap) -> dict[int, int]:
    """Truth id → label id: the one-to-one assignment with the largest ΣF; pairs with F = 0 are left out."""
    _, _, f = _region_scores(overlap)
    rows, columns = linear_sum_assignment(f, maximize=True)
    return {
        int(overlap.objects[row]): int(overlap.labels[column])
        for row, column in zip(rows, columns, strict=True)
        if f[row, column] > 0
    }


def _region_means(overlap: FrameOverlap, count_extras: bool) -> Agreement:
    precision, recall, f = _region_scores(overlap)
    matches = match_objects(overlap)
    rows = np.searchsorted(overlap.objects, list(matches.keys())).astype(np.intp)
    columns = np.searchsorted(overlap.labels, list(matches.values())).astype(np.intp)
    lost = len(overlap.objects) - len(matches)
    extra = len(overlap.labels) - len(matches) if count_extras else 0
    regions = len(matches) + lost + extra
    if regions == 0:
        return Agreement(1.0, 1.0, 1.0)
    # A region without a partner has P = 1, R = 0, F = 0.
    return Agreement(
        float((precision[rows, columns].sum() + lost + extra) / regions),
        float(recall[rows, columns].sum() / regions),
        float(f[rows, columns].sum() / regions),
    )


def multi_label(overlap: FrameOverlap) -> Agreement:
    """The paper's multi-label figure (§8): mean over matched, lost and extra regions of one frame."""
    return _region_means(overlap, count_extras=True)


def object_level(overlap: FrameOverlap) -> Agreement:
    """As :func:`multi_label` without the extra regions: mean over truth objects, a lost one has F = 0."""
    return _region_means(overlap, count_extras=False)


def multi_label_matlab(overlap: FrameOverlap) -> float:
    """The figure of the authors' program: F = Σ 2PR(P+R) / Σ (P+R)² over the objects of one frame.

    Regions are assigned on pixel overlap with the background among them; its row is dropped afterwards and
    extra regions are ignored. An object without a partner, or with one it does not touch, has P = 1, R = 0.
    NaN without truth objects.
    """
    counts = overlap.counts
    rows, columns = linear_sum_assignment(counts, maximize=True)
    numerator = denominator = 0.0
    partner = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    for row in range(1, counts.shape[0]):
        column = partner.get(row)
        precision, recall = 1.0, 0.0
        if column is not None and counts[row, column]:
            precision = float(counts[row, column] / counts[:, column].sum())
            recall = float(counts[row, column] / counts[row].sum())
        numerator += 2 * precision * recall * (precision + recall)
        denominator += (precision + recall) ** 2
    return numerator / denominator if denominator else float("nan")


def id_switches(overlaps: Iterable[FrameOverlap]) -> int:
    """How often the label matched to a truth object differs from the one last matched to it."""
    last: dict[int, int] = {}
    switches = 0
    for overlap in overlaps:
        for truth_id, label in match_objects(overlap).items():
            switches += last.get(truth_id, label) != label
            last[truth_id] = label
    return switches


def moving_objects(truth: Array, flow: Array) -> list[int]:
    """Truth ids that show ≥ 400 px and move ≥ 1 px/frame against their surroundings, ascending.

    Parameters
    ----------
    truth : (H, W) uint8
    flow : (H, W, 2) float32
        Exact motion, px/frame, of either direction.

    Notes
    -----
    The surroundings are the pixels within 12 px of the object that are not its own; both motions are means.
    """
    areas = np.bincount(truth.ravel(), minlength=IGNORE + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SURROUNDINGS + 1, 2 * SURROUNDINGS + 1))
    moving = []
    for truth_id in range(1, IGNORE):
        if areas[truth_id] < MIN_ENTRY_AREA:
            continue
        own = truth == truth_id
        around = (cv2.dilate(own.astype(np.uint8), kernel) > 0) & ~own
        if not around.any():
            continue
        difference = flow[own].mean(axis=0, dtype=np.float64) - flow[around].mean(axis=0, dtype=np.float64)
        if float(np.hypot(*difference)) >= MIN_ENTRY_SPEED:
            moving.append(truth_id)
    return moving


def entry_delays(overlaps: Iterable[FrameOverlap], entries: Mapping[int, int]) -> dict[int, int | None]:
    """Frames from each object's entry to the first frame in which one label has IoU ≥ 0.5 with it.

    Parameters
    ----------
    overlaps : iterable of FrameOverlap
        In ascending frame index.
    entries : mapping of int to int
        Truth id → frame index of its entry (the first frame of :func:`moving_objects`).
    """
    delays: dict[int, int | None] = dict.fromkeys(sorted(entries))
    for overlap in overlaps:
        inside = overlap.counts[1:, 1:]
        union = overlap.counts[1:].sum(axis=1)[:, None] + overlap.counts[:, 1:].sum(axis=0)[None, :] - inside
        best = (inside / union).max(axis=1, initial=0.0)
        for truth_id, iou in zip(overlap.objects.tolist(), best, strict=True):
            waiting = truth_id in entries and delays[truth_id] is None
            if waiting and overlap.index >= entries[truth_id] and iou >= FOUND_IOU:
                delays[truth_id] = overlap.index - entries[truth_id]
    return delays


def _score_range(overlaps: Sequence[FrameOverlap]) -> RangeScore:
    binary = [two_label(overlap) for overlap in overlaps]
    with_objects = [overlap for overlap in overlaps if len(overlap.objects)]
    return RangeScore(
        frames=len(overlaps),
        precision=_mean(agreement.precision for agreement in binary),
        recall=_mean(agreement.recall for agreement in binary),
        two_label_f=_mean(agreement.f for agreement in binary),
        j=_mean(jaccard(overlap) for overlap in overlaps),
        multi_f=_mean(multi_label(overlap).f for overlap in with_objects),
        object_f=_mean(object_level(overlap).f for overlap in with_objects),
        multi_f_matlab=_mean(multi_label_matlab(overlap) for overlap in with_objects),
    )


def _mean(values: Iterable[float]) -> float:
    collected = list(values)
    return sum(collected) / len(collected) if collected else float("nan")


@dataclass(slots=True)
class _Life:
    """What is known so far of one label id."""

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
        """All figures of the frames taken so far."""
        extras = tuple(self._extras())
        return SequenceScore(
            frames=self._frames,
            all_frames=_score_range(self._overlaps),
            first_ten=_score_range([overlap for overlap in self._overlaps if overlap.index < 10]),
            after_start=_score_range([o for o in self._overlaps if o.index >= START_FRAMES]),
            davis=_score_range(self._overlaps[1:-1]),
            extra_layers=100.0 * len(extras) / self._frames if self._frames else 0.0,
            extras=extras,
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
    """Bounding box of a mask and the mask inside it."""
    region = Region(*cv2.boundingRect(mask.astype(np.uint8)))
    return region, mask[region.slices].copy()
