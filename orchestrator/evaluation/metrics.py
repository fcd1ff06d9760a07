"""Agreement of label maps with truth, per frame, and consistency of labels and objects over time.

Every figure is a function of two small tables a frame, the pixel counts and the boundary measure F of each
(truth object, label) pair (:class:`FrameOverlap`), so no label map needs to be kept.

Truth: 0 = background, 1 … 254 = objects, 255 = not judged; such pixels belong to no region of either side.

Differs from the paper: the paper's multi-label figure (:func:`multi_label`) counts every extra region as a
failure, even a real small mover that the truth leaves out; :func:`object_level` ignores extra regions.
:func:`multi_label_matlab` follows the authors' program, which weights the objects of a frame by (P + R)².
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array
from orchestrator.evaluation.boundary import boundary_f, outline_of, pairwise_f

__all__ = [
    "NOT_JUDGED",
    "Agreement",
    "FrameOverlap",
    "TrackScore",
    "count_overlap",
    "davis_tracks",
    "entry_delays",
    "id_switches",
    "ids_on",
    "jaccard",
    "match_objects",
    "moving_objects",
    "multi_label",
    "multi_label_matlab",
    "object_level",
    "track_j",
    "two_label",
]

#: Truth value of the pixels that are not judged.
NOT_JUDGED = 255

MIN_ENTRY_AREA = 400  # visible px from which an object counts as entered
MIN_ENTRY_SPEED = 1.0  # px/frame against its surroundings
SURROUNDINGS = 12  # width of the ring around an object that counts as its surroundings, px
FOUND_IOU = 0.5
MIN_FRAMES_ON = 3  # frames in which a label must lie on an object to count as one of its ids


class Agreement(NamedTuple):
    """Precision, recall and F of one frame, each in [0, 1]."""

    precision: float
    recall: float
    f: float


@dataclass(frozen=True, slots=True)
class FrameOverlap:
    """Pixel counts and boundaries of every pair of a truth object and a label in one frame.

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
    boundary_f : float
        Boundary measure F of all that moves, in [0, 1]; see :mod:`orchestrator.evaluation.boundary`.
    pair_boundary_f : (g, l) float64
        The same of every pair of a truth object and a label.
    """

    index: int
    objects: Array
    labels: Array
    counts: Array
    boundary_f: float
    pair_boundary_f: Array


def count_overlap(labels: Array, truth: Array, index: int = 0) -> FrameOverlap:
    """Count the judged pixels of every (truth object, label) pair, and compare their boundaries.

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
    judged = truth != NOT_JUDGED
    object_ids, object_rank = _ranks(truth[judged])
    label_ids, label_rank = _ranks(labels[judged])
    joint = object_rank * len(label_ids) + label_rank
    counts = np.bincount(joint, minlength=len(object_ids) * len(label_ids))
    objects = [outline_of(truth == one) for one in object_ids[1:]]
    found = [outline_of((labels == one) & judged) for one in label_ids[1:]]
    return FrameOverlap(
        index,
        object_ids[1:],
        label_ids[1:],
        counts.reshape(len(object_ids), len(label_ids)),
        boundary_f(outline_of((truth > 0) & judged), outline_of((labels > 0) & judged)),
        pairwise_f(objects, found),
    )


def _ranks(values: Array) -> tuple[Array, Array]:
    """Return the ids present (always with 0, ascending) and each value's index among them."""
    present = np.bincount(values, minlength=1) > 0
    present[0] = True
    ids = np.flatnonzero(present)
    rank = np.cumsum(present) - 1
    return ids, rank[values]


def two_label(overlap: FrameOverlap) -> Agreement:
    """Score moving against still, whatever the label: nothing on both sides scores 1, on one side F = 0."""
    counts = overlap.counts
    both = int(counts[1:, 1:].sum())
    found, true = int(counts[:, 1:].sum()), int(counts[1:].sum())
    if found == 0 and true == 0:
        return Agreement(1.0, 1.0, 1.0)
    precision = both / found if found else 1.0
    recall = both / true if true else 1.0
    return Agreement(precision, recall, 2 * both / (found + true))


def jaccard(overlap: FrameOverlap) -> float:
    """Return intersection over union of moving pixels; nothing on both sides scores 1."""
    counts = overlap.counts
    union = int(counts.sum() - counts[0, 0])
    return float(counts[1:, 1:].sum() / union) if union else 1.0


def _region_scores(overlap: FrameOverlap) -> tuple[Array, Array, Array]:
    """Return precision, recall and F of every (object, label) pair: three (g, l) float64 arrays."""
    counts = overlap.counts
    inside = counts[1:, 1:]
    label_area = counts[:, 1:].sum(axis=0)[None, :]
    object_area = counts[1:].sum(axis=1)[:, None]
    return inside / label_area, inside / object_area, 2 * inside / (label_area + object_area)


def _ious(overlap: FrameOverlap) -> Array:
    """Return intersection over union of every (object, label) pair: (g, l) float64."""
    counts = overlap.counts
    inside = counts[1:, 1:]
    union = counts[1:].sum(axis=1)[:, None] + counts[:, 1:].sum(axis=0)[None, :] - inside
    ious: Array = inside / union
    return ious


def match_objects(overlap: FrameOverlap) -> dict[int, int]:
    """Map truth ids to label ids: the one-to-one assignment with the largest ΣF, without pairs of F = 0."""
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
    """Return the paper's multi-label figure (§8): mean over matched, lost and extra regions of one frame."""
    return _region_means(overlap, count_extras=True)


def object_level(overlap: FrameOverlap) -> Agreement:
    """Score as :func:`multi_label` without extra regions: mean over truth objects, a lost one has F = 0."""
    return _region_means(overlap, count_extras=False)


def multi_label_matlab(overlap: FrameOverlap) -> Agreement:
    """Return the figures of the authors' program: F = Σ 2PR(P+R) / Σ (P+R)² over the objects of one frame.

    Precision and recall are the plain means over the objects. Regions are assigned on pixel overlap with the
    background among them; its row is dropped afterwards and extra regions are ignored. An object without a
    partner, or with one it does not touch, has P = 1, R = 0. NaN without truth objects.
    """
    counts = overlap.counts
    rows, columns = linear_sum_assignment(counts, maximize=True)
    precisions, recalls = [], []
    partner = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    for row in range(1, counts.shape[0]):
        column = partner.get(row)
        precision, recall = 1.0, 0.0
        if column is not None and counts[row, column]:
            precision = float(counts[row, column] / counts[:, column].sum())
            recall = float(counts[row, column] / counts[row].sum())
        precisions.append(precision)
        recalls.append(recall)
    if not precisions:
        return Agreement(math.nan, math.nan, math.nan)
    pairs = list(zip(precisions, recalls, strict=True))
    numerator = sum(2 * precision * recall * (precision + recall) for precision, recall in pairs)
    denominator = sum((precision + recall) ** 2 for precision, recall in pairs)
    count = len(pairs)
    return Agreement(sum(precisions) / count, sum(recalls) / count, numerator / denominator)


def id_switches(overlaps: Iterable[FrameOverlap]) -> int:
    """Count how often the label matched to a truth object differs from the one last matched to it."""
    last: dict[int, int] = {}
    switches = 0
    for overlap in overlaps:
        for truth_id, label in match_objects(overlap).items():
            switches += last.get(truth_id, label) != label
            last[truth_id] = label
    return switches


def track_j(overlaps: Iterable[FrameOverlap]) -> float:
    """Score one label for each truth object over the whole sequence, in [0, 1]; NaN without truth objects.

    Objects and labels are matched one to one, with the largest sum of mean IoU. The result is the mean over
    the truth objects; one without a label scores 0, surplus labels do not count.

    Parameters
    ----------
    overlaps : iterable of FrameOverlap
        The frames with truth.

    Notes
    -----
    A pair's mean is over the frames in which the object or the label is there; if one is there alone, the
    frame counts 0. DAVIS 2017's unsupervised task, whose matching this is, counts 1 for a frame with neither,
    so that there a lost object gains by being out of sight.
    """
    ious: defaultdict[tuple[int, int], float] = defaultdict(float)
    together: Counter[tuple[int, int]] = Counter()
    object_frames: Counter[int] = Counter()
    label_frames: Counter[int] = Counter()
    for overlap in overlaps:
        objects, labels = overlap.objects.tolist(), overlap.labels.tolist()
        object_frames.update(objects)
        label_frames.update(labels)
        for (row, column), iou in np.ndenumerate(_ious(overlap)):
            ious[objects[row], labels[column]] += iou
            together[objects[row], labels[column]] += 1
    if not object_frames:
        return math.nan
    means = np.zeros((len(object_frames), len(label_frames)))
    for row, (truth_id, seen) in enumerate(object_frames.items()):
        for column, (label, labelled) in enumerate(label_frames.items()):
            pair = truth_id, label
            means[row, column] = ious[pair] / (seen + labelled - together[pair])
    rows, columns = linear_sum_assignment(means, maximize=True)
    return float(means[rows, columns].sum() / len(object_frames))


class TrackScore(NamedTuple):
    """One truth object and the label matched to it: mean J and F of all frames with truth, each in [0, 1].

    ``label`` is None if more objects than labels are there.
    """

    truth_id: int
    label: int | None
    j: float
    f: float

    @property
    def j_and_f(self) -> float:
        """Mean of ``j`` and ``f``."""
        return (self.j + self.f) / 2


def davis_tracks(overlaps: Sequence[FrameOverlap]) -> list[TrackScore]:
    """Score one label for each truth object, as DAVIS 2017's unsupervised task does; ascending truth ids.

    Objects and labels are matched one to one, with the largest sum of mean (J + F) / 2. Surplus labels do not
    count.

    Notes
    -----
    As there, the means are over all frames with truth, the first and the last included, and a frame with
    neither the object nor its label counts 1. An object for which no label is left is matched to nothing.
    """
    objects = sorted({one for overlap in overlaps for one in overlap.objects.tolist()})
    labels = sorted({one for overlap in overlaps for one in overlap.labels.tolist()})
    # Columns without a label, so that every object has a partner; they are empty in every frame.
    columns = max(len(labels), len(objects))
    total_j, total_f = np.zeros((len(objects), columns)), np.zeros((len(objects), columns))
    for overlap in overlaps:
        rows = np.searchsorted(objects, overlap.objects).astype(np.intp)
        found = np.searchsorted(labels, overlap.labels).astype(np.intp)
        neither = np.ones((len(objects), columns))
        neither[rows], neither[:, found] = 0.0, 0.0
        for total, pairs in ((total_j, _ious(overlap)), (total_f, overlap.pair_boundary_f)):
            total += neither
            total[np.ix_(rows, found)] += pairs
    chosen = linear_sum_assignment(total_j + total_f, maximize=True)
    return [
        TrackScore(
            objects[row],
            labels[column] if column < len(labels) else None,
            float(total_j[row, column] / len(overlaps)),
            float(total_f[row, column] / len(overlaps)),
        )
        for row, column in zip(*(one.tolist() for one in chosen), strict=True)
    ]


def ids_on(overlaps: Iterable[FrameOverlap]) -> float:
    """Count the labels on a truth object, mean over the objects; NaN without truth objects.

    A label is on an object if at least half of its judged pixels are in at least three frames with truth.
    """
    objects: set[int] = set()
    frames: Counter[tuple[int, int]] = Counter()
    for overlap in overlaps:
        objects.update(overlap.objects.tolist())
        mostly_on = 2 * overlap.counts[1:, 1:] >= overlap.counts[:, 1:].sum(axis=0)
        rows, columns = np.nonzero(mostly_on)
        frames.update(zip(overlap.objects[rows].tolist(), overlap.labels[columns].tolist(), strict=True))
    if not objects:
        return math.nan
    return sum(count >= MIN_FRAMES_ON for count in frames.values()) / len(objects)


def moving_objects(truth: Array, flow: Array) -> list[int]:
    """List truth ids that show ≥ 400 px and move ≥ 1 px/frame against their surroundings, ascending.

    Parameters
    ----------
    truth : (H, W) uint8
    flow : (H, W, 2) float32
        Exact motion, px/frame, of either direction.

    Notes
    -----
    The surroundings are the pixels within 12 px of the object that are not its own; both motions are means.
    """
    areas = np.bincount(truth.ravel(), minlength=NOT_JUDGED + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SURROUNDINGS + 1, 2 * SURROUNDINGS + 1))
    moving = []
    for truth_id in range(1, NOT_JUDGED):
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
    """Count the frames from each object's entry to the first in which one label has IoU ≥ 0.5 with it.

    Parameters
    ----------
    overlaps : iterable of FrameOverlap
        In ascending frame index.
    entries : mapping of int to int
        Truth id → frame index of its entry (the first frame of :func:`moving_objects`).
    """
    delays: dict[int, int | None] = dict.fromkeys(sorted(entries))
    for overlap in overlaps:
        best = _ious(overlap).max(axis=1, initial=0.0)
        for truth_id, iou in zip(overlap.objects.tolist(), best, strict=True):
            waiting = truth_id in entries and delays[truth_id] is None
            if waiting and overlap.index >= entries[truth_id] and iou >= FOUND_IOU:
                delays[truth_id] = overlap.index - entries[truth_id]
    return delays
