"""Agreement of the label map of a frame with its truth.

Every figure is a function of two small tables a frame, the pixel counts and the boundary measure F of each
(truth object, label) pair (:class:`~orchestrator.evaluation.overlap.FrameOverlap`), so no label map needs to
be kept. Those of a whole sequence are in :mod:`orchestrator.evaluation.track_metrics`.

Differs from the paper: the paper's multi-label figure (:func:`multi_label`) counts every extra region as a
failure, even a real small mover that the truth leaves out; :func:`object_level` ignores extra regions.
:func:`multi_label_matlab` follows the authors' program, which weights the objects of a frame by (P + R)².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from mlbs_actors.messages import Array
from orchestrator.evaluation.overlap import FrameOverlap

__all__ = [
    "Agreement",
    "false_area",
    "jaccard",
    "match_objects",
    "multi_label",
    "multi_label_matlab",
    "object_level",
    "two_label",
]


class Agreement(NamedTuple):
    """Precision, recall and F of one frame, each in [0, 1]."""

    precision: float
    recall: float
    f: float


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


def false_area(overlap: FrameOverlap) -> float:
    """Return the share of the judged pixels that are labelled but background, in [0, 1]."""
    counts = overlap.counts
    return float(counts[0, 1:].sum() / max(int(counts.sum()), 1))


def _region_scores(overlap: FrameOverlap) -> tuple[Array, Array, Array]:
    """Return precision, recall and F of every (object, label) pair: three (g, l) float64 arrays."""
    counts = overlap.counts
    inside = counts[1:, 1:]
    label_area = counts[:, 1:].sum(axis=0)[None, :]
    object_area = counts[1:].sum(axis=1)[:, None]
    return inside / label_area, inside / object_area, 2 * inside / (label_area + object_area)


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
