"""How the labels of a frame lie on its truth: all that is kept of a label map to score it.

Truth: 0 = background, 1 … 254 = objects, 255 = not judged; such pixels belong to no region of either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array
from orchestrator.evaluation.boundary import boundary_f, outline_of, pairwise_f

__all__ = ["NOT_JUDGED", "FrameOverlap", "count_overlap", "ious_of"]

#: Truth value of the pixels that are not judged.
NOT_JUDGED = 255


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


def ious_of(overlap: FrameOverlap) -> Array:
    """Return intersection over union of every (object, label) pair: (g, l) float64."""
    counts = overlap.counts
    inside = counts[1:, 1:]
    union = counts[1:].sum(axis=1)[:, None] + counts[:, 1:].sum(axis=0)[None, :] - inside
    ious: Array = inside / union
    return ious
