"""Removal of strays, specks and holes from a label map (§7; the authors' program cleans what it learns from).

Components are found by their runs (:mod:`mlbs_actors.segmentation.label_runs`).

Differs from the authors' program, which publishes the raw map and learns from the cleaned one: here they are
the same map. A component smaller than the limit goes to the neighbour with the longest common border; the
largest component of a label is never a speck, so a small distant object survives. A component that holds
trajectories of another object, and none of its own, goes to that object: a layer has taken for its own what
it once was before, and does not let go of it.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.segmentation.label_runs import label_runs

__all__ = ["clean_labels"]


@compiled
def clean_labels(
    labels: Array,
    box: tuple[int, int, int, int],
    speck_px: float,
    hole_px: float,
    tracks: Array,
    stray_tracks: int,
) -> None:
    """Remove small components of every label in a box, in place.

    Parameters
    ----------
    labels : (H, W) unsigned integer
        Label map, 0 = background.
    box : (x, y, width, height)
        Around objects; along its sides there is only background, except on the border of the frame.
    speck_px : float
        Components of a label > 0 below this area are removed, except each label's largest, px².
    hole_px : float
        Components of the background below this area are filled, px².
    tracks : (n, 3) int64
        Row and column of the objects' trajectories in the map, and their labels.
    stray_tracks : int
        So many trajectories of another object make a component without any of its own that object's.
    """
    left, top, width, height = box
    bottom, right = top + height, left + width
    cleaned = labels[top:bottom, left:right]
    rows, starts, ends, of_run = label_runs(cleaned, False)
    # The background continues past any side that is not the frame's.
    beyond = (left > 0, top > 0, right < labels.shape[1], bottom < labels.shape[0])
    label_of, areas = _measured(cleaned, rows, starts, ends, of_run, beyond, labels.size - cleaned.size)
    first = np.searchsorted(rows, np.arange(height + 1))
    held = np.zeros((areas.size, max(label_of.max(), tracks[:, 2].max() if len(tracks) else 0) + 1), np.int64)
    for y, x, label in tracks:
        if top <= y < bottom and left <= x < right:
            run = first[y - top]
            while ends[run] <= x - left:
                run += 1
            held[of_run[run], label] += 1
    for one in range(areas.size):
        if label_of[one] != BACKGROUND and held[one, label_of[one]] == 0:
            other = held[one].argmax()
            if held[one, other] >= stray_tracks:
                label_of[one] = other
                for run in np.flatnonzero(of_run == one):
                    cleaned[rows[run], starts[run] : ends[run]] = other
    largest = np.full(label_of.max() + 1, -1)
    for one in range(areas.size):
        if largest[label_of[one]] < 0 or areas[one] > areas[largest[label_of[one]]]:
            largest[label_of[one]] = one
    # Specks first: they must not become part of a hole.
    for label in range(largest.size - 1, -1, -1):
        limit = hole_px if label == BACKGROUND else speck_px
        for one in range(areas.size):
            if label_of[one] == label and one != largest[label] and areas[one] < limit:
                own = np.flatnonzero(of_run == one)
                _give_away(cleaned, rows[own], starts[own], ends[own])


@compiled
def _measured(
    labels: Array, rows: Array, starts: Array, ends: Array, of_run: Array,
    beyond: tuple[bool, bool, bool, bool], area_beyond: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Return label and area of each component; ``beyond`` flags open sides: left, top, right, bottom."""
    height, width = labels.shape
    count = of_run.max() + 1
    label_of, areas = np.zeros(count, np.int64), np.zeros(count, np.int64)
    goes_on = np.zeros(count, np.bool_)
    for run in range(rows.size):
        one = of_run[run]
        label_of[one] = labels[rows[run], starts[run]]
        areas[one] += ends[run] - starts[run]
        goes_on[one] |= (
            (beyond[0] and starts[run] == 0)
            or (beyond[1] and rows[run] == 0)
            or (beyond[2] and ends[run] == width)
            or (beyond[3] and rows[run] == height - 1)
        )
    for one in range(count):
        if goes_on[one] and label_of[one] == BACKGROUND:
            areas[one] += area_beyond
    return label_of, areas


@compiled
def _give_away(labels: Array, rows: Array, starts: Array, ends: Array) -> None:
    """Give a component the label of most of the pixels around it, the lowest of several."""
    top, bottom = max(rows[0] - 1, 0), min(rows[-1] + 2, labels.shape[0])
    left, right = max(starts.min() - 1, 0), min(ends.max() + 1, labels.shape[1])
    inside = np.zeros((bottom - top, right - left), np.bool_)
    for run in range(rows.size):
        inside[rows[run] - top, starts[run] - left : ends[run] - left] = True
    votes = np.zeros(np.int64(labels[top:bottom, left:right].max()) + 1, np.int64)
    for v in range(inside.shape[0]):
        for u in range(inside.shape[1]):
            if not inside[v, u] and inside[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2].any():
                votes[labels[v + top, u + left]] += 1
    if votes.any():
        winner = votes.argmax()
        for run in range(rows.size):
            labels[rows[run], starts[run] : ends[run]] = winner
