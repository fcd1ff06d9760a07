"""Agreement of labels with truth over a sequence: whether an object keeps its label, and when it gets one."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from mlbs_actors.messages import Array
from orchestrator.evaluation.frame_statistics import FrameStatistics, frame_statistics
from orchestrator.evaluation.metrics import match_objects
from orchestrator.evaluation.overlap import NOT_JUDGED, FrameOverlap, ious_of

__all__ = [
    "TrackScore",
    "davis_tracks",
    "entry_delays",
    "id_switches",
    "ids_on",
    "moving_objects",
    "shared_ids",
    "track_j",
]

MIN_ENTRY_AREA = 400  # visible px from which an object counts as entered
MIN_ENTRY_SPEED = 1.0  # px/frame against its surroundings
SURROUNDINGS = 12  # width of the ring around an object that counts as its surroundings, px
FOUND_IOU = 0.5
MIN_FRAMES_ON = 3  # frames in which a label must lie on an object to count as one of its ids
MIN_FOUND = 0.3  # share of an object's pixels under one label from which on it counts as found


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
        for (row, column), iou in np.ndenumerate(ious_of(overlap)):
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


@dataclass(frozen=True, slots=True)
class TrackScore:
    """One truth object and the label matched to it.

    Attributes
    ----------
    truth_id : int
    label : int or None
        None if more objects than labels are there.
    j, f : FrameStatistics
        Over all frames with truth.
    """

    truth_id: int
    label: int | None
    j: FrameStatistics
    f: FrameStatistics

    @property
    def j_and_f(self) -> float:
        """Mean of J and F."""
        return (self.j.mean + self.f.mean) / 2


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
        for total, measured in ((total_j, ious_of(overlap)), (total_f, overlap.pair_boundary_f)):
            total += neither
            total[np.ix_(rows, found)] += measured
    chosen = linear_sum_assignment(total_j + total_f, maximize=True)
    pairs = [
        (objects[row], labels[column] if column < len(labels) else None)
        for row, column in zip(*(one.tolist() for one in chosen), strict=True)
    ]
    return [_track_score(overlaps, *pair) for pair in pairs]


def _track_score(overlaps: Sequence[FrameOverlap], truth_id: int, label: int | None) -> TrackScore:
    j, f = [], []
    for overlap in overlaps:
        row, column = np.flatnonzero(overlap.objects == truth_id), np.flatnonzero(overlap.labels == label)
        pair = np.ix_(row, column)
        neither = float(not row.size and not column.size)
        j.append(float(ious_of(overlap)[pair].sum()) + neither)
        f.append(float(overlap.pair_boundary_f[pair].sum()) + neither)
    return TrackScore(truth_id, label, frame_statistics(j), frame_statistics(f))


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


def shared_ids(overlaps: Iterable[FrameOverlap]) -> float:
    """Return how often an object that is found shares its label with another one, in [0, 1].

    The counterpart of :func:`ids_on`, which alone would reward one label for everything. An object's label in
    a frame is the one on most of its judged pixels; the object is found if they are at least 30 %. The result
    is the share of all found objects of all frames whose label is another found object's, too; NaN if nothing
    is found.
    """
    found = shared = 0
    for overlap in overlaps:
        if not overlap.labels.size or not overlap.objects.size:
            continue
        counts = overlap.counts[1:]
        main = counts[:, 1:].argmax(axis=1)
        is_found = counts[:, 1:].max(axis=1) >= MIN_FOUND * counts.sum(axis=1)
        holders = np.bincount(main[is_found], minlength=overlap.labels.size)
        found += int(is_found.sum())
        shared += int(holders[holders > 1].sum())
    return shared / found if found else math.nan


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
        best = ious_of(overlap).max(axis=1, initial=0.0)
        for truth_id, iou in zip(overlap.objects.tolist(), best, strict=True):
            waiting = truth_id in entries and delays[truth_id] is None
            if waiting and overlap.index >= entries[truth_id] and iou >= FOUND_IOU:
                delays[truth_id] = overlap.index - entries[truth_id]
    return delays
