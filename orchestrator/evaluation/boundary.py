"""The boundary measure F of DAVIS: how well the outline of one region follows that of another.

The boundary of a region is the pixels that differ from their neighbour to the right, below, or diagonally
below to the right. A boundary pixel is right if the disk around it, of 0.008 × the frame's diagonal rounded
up, holds a boundary pixel of the other region. Precision is the share of right pixels in the label's
boundary, recall that in the truth's, and F their harmonic mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["REACH", "Outline", "boundary_f", "outline_of", "pairwise_f"]

#: Radius of the disk, × the diagonal of the frame.
REACH = 0.008


@dataclass(frozen=True, slots=True)
class Outline:
    """The boundary of a region, and what is close enough to it.

    Attributes
    ----------
    rows, columns : (n,) intp
        The boundary's pixels.
    top, left : int
        Where ``near`` begins.
    near : (h, w) bool
        Pixels within the disk around a boundary pixel; all others of the frame are not.
    """

    rows: Array
    columns: Array
    top: int
    left: int
    near: Array

    def share_near(self, other: Outline) -> float:
        """Return the share of this boundary that is near the other one, which must both have pixels."""
        rows, columns = self.rows - other.top, self.columns - other.left
        height, width = other.near.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return float(other.near[rows[inside], columns[inside]].sum() / len(rows))


def outline_of(mask: Array) -> Outline:
    """Find the boundary of a region.

    Parameters
    ----------
    mask : (H, W) bool
    """
    edge = _boundary(mask)
    rows, columns = np.nonzero(edge)
    if not len(rows):
        return Outline(rows, columns, 0, 0, np.zeros((0, 0), bool))
    reach = math.ceil(REACH * math.hypot(*mask.shape))
    top, left = max(int(rows.min()) - reach, 0), max(int(columns.min()) - reach, 0)
    around = edge[top : rows.max() + reach + 1, left : columns.max() + reach + 1]
    distance = cv2.distanceTransform((~around).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # Between a distance of the reach and the next larger one there is more than this, up to a diagonal of
    # 10,000 px.
    return Outline(rows, columns, top, left, distance <= reach + 0.005)


def boundary_f(truth: Outline, label: Outline) -> float:
    """Return F of two boundaries, in [0, 1]: none on both sides scores 1, on one side 0."""
    if not len(truth.rows) or not len(label.rows):
        return float(len(truth.rows) == len(label.rows))
    precision, recall = label.share_near(truth), truth.share_near(label)
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def pairwise_f(truths: Sequence[Outline], labels: Sequence[Outline]) -> Array:
    """Return F of every pair: (g, l) float64."""
    pairs = [boundary_f(truth, label) for truth in truths for label in labels]
    return np.array(pairs, np.float64).reshape(len(truths), len(labels))


def _boundary(mask: Array) -> Array:
    """Return the pixels that differ from a neighbour to the right or below: (H, W) bool."""
    padded = np.pad(mask, ((0, 1), (0, 1)), mode="edge")
    boundary: Array = (mask != padded[:-1, 1:]) | (mask != padded[1:, :-1]) | (mask != padded[1:, 1:])
    return boundary
