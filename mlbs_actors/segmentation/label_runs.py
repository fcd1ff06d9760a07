"""Runs of one label in the rows of a label map, and the components that they form."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["label_runs"]


@compiled
def label_runs(labels: Array, diagonal: bool) -> tuple[Array, Array, Array, Array]:
    """Find the runs and the connected components of all labels.

    Parameters
    ----------
    labels : (h, w) unsigned integer
    diagonal : bool
        Whether pixels that touch at a corner are connected too.

    Returns
    -------
    rows, starts, ends : (n,) int64
        Row, first column and column past the last of every run, in raster order.
    component : (n,) int64
        Of every run; components are numbered in the order of their first runs.
    """
    height, width = labels.shape
    count, reach = 0, int(diagonal)
    for y in range(height):
        count, row = count + 1, labels[y]
        for x in range(1, width):
            count += row[np.uint64(x)] != row[np.uint64(x - 1)]
    rows, starts, ends = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    parent = np.empty(count, np.int64)
    run, above, above_end = 0, 0, 0
    for y in range(height):
        row, row_begin, x = labels[y], run, 0
        while x < width:
            label, start = row[np.uint64(x)], x
            while x < width and row[np.uint64(x)] == label:
                x += 1
            rows[run], starts[run], ends[run], parent[run] = y, start, x, run
            while above < above_end and ends[above] + reach <= start:
                above += 1
            other = above
            while other < above_end and starts[other] < x + reach:
                if labels[y - 1, starts[other]] == label:
                    one, two = _root(parent, other), _root(parent, run)
                    parent[max(one, two)] = min(one, two)
                other += 1
            run += 1
        above, above_end = row_begin, run
    component = np.empty(count, np.int64)
    found = 0
    for run in range(count):
        root = _root(parent, run)
        if root == run:
            component[run] = found
            found += 1
        else:
            component[run] = component[root]
    return rows, starts, ends, component


@compiled
def _root(parent: Array, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run
