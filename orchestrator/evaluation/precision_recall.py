"""Precision and recall of masks, by the score of their objects: what a threshold on it would leave.

A mask is right if its intersection over union with an object of the truth is above a half; no two masks of a
frame can be so for one object. Precision is the share of right masks among those kept, recall that of the
objects that a kept mask is right for among all objects of all frames with truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mlbs_actors.messages import Array
from orchestrator.evaluation.scoring import SequenceResult

__all__ = ["PrecisionRecall", "precision_recall"]

_RIGHT = 0.5


@dataclass(frozen=True, slots=True)
class PrecisionRecall:
    """A point for each score of an object, the highest first.

    Attributes
    ----------
    least_score : (n,) float64
        Objects of this score or a higher one are kept.
    precision, recall : (n,) float64
        In [0, 1].
    """

    least_score: Array
    precision: Array
    recall: Array

    @property
    def average_precision(self) -> float:
        """Area under precision over recall, where precision counts as the best of any lower threshold."""
        best = np.maximum.accumulate(self.precision[::-1])[::-1]
        return float((np.diff(self.recall, prepend=0.0) * best).sum())


def precision_recall(results: Sequence[SequenceResult]) -> PrecisionRecall | None:
    """Count the masks of sequences by their objects' score.

    Returns
    -------
    PrecisionRecall or None
        None without objects in the truth, or without masks of known score.
    """
    masks = [mask for result in results for mask in result.masks]
    objects = sum(
        len(frame.matches)
        for result in results
        if result.score is not None and result.masks
        for frame in result.score.per_frame
    )
    if not masks or not objects:
        return None
    score = np.array([mask.object_score for mask in masks])
    right = np.array([mask.iou > _RIGHT for mask in masks])
    order = np.argsort(-score, kind="stable")
    last = np.flatnonzero(np.diff(score[order], append=-1.0))  # of equal scores all are kept, or none
    kept, found = last + 1, np.cumsum(right[order])[last]
    return PrecisionRecall(score[order][last], found / kept, found / objects)
