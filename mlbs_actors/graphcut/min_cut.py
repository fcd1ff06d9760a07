"""Minimum cut of a graph of pixels by incremental breadth-first search (Goldberg, Hed, Kaplan, Tarjan and
Werneck, ESA 2011).

A tree of unsaturated edges grows from the sink, level by level. Where it meets a pixel with excess from the
source, that flows along the path, and nodes cut off by a saturated edge look for a new parent. The tree stays
a breadth-first tree: a pixel never comes nearer to the sink again, and its parent lies one level nearer than
it. So paths are short, and an orphan needs only a neighbour of that level, without the check of Boykov and
Kolmogorov that the path from there leads to the sink. At the end the tree is the sink's side, and the
smallest such set.

Differs from the authors' program: no second tree grows from the source, as most pixels have a terminal edge
of their own. And no edge is stored: pixels have eight neighbours, and the edge to the k-th is the reverse of
that neighbour's edge to its own (k + 4 mod 8)-th. The size of a pixel matters: a general graph spends most of
its time on allocating and filling memory. Along a path every index depends on the one before, and a signed
one also on the check for negative values: hence unsigned indices.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["min_cut"]

#: Values of a pixel's parent besides one of its eight neighbours: the sink, or lost.
_TO_SINK, _LOST = 8, 9
#: Edge k of pixel p has the number 8 p + k; its reverse has k with this bit flipped.
_EDGE_BITS, _OPPOSITE = np.uint64(3), np.uint64(4)


@compiled
def min_cut(surplus: Array, neighbour: Array, residual: Array) -> tuple[np.int64, Array]:
    """Cut a graph of n pixels.

    Parameters
    ----------
    surplus : (n,) int32
        Capacity from the source less that to the sink; replaced by the residual.
    neighbour : (n, 8) int32
        Pixels that edges lead to: that of entry k has this one as its entry (k + 4) mod 8. −1 if there is
        none.
    residual : (n, 8) int32
        Capacities of the edges, ≥ 0, and 0 where there is none; replaced by the residuals.

    Returns
    -------
    flow : int
        Weight of the minimum cut.
    on_sink_side : (n,) bool
    """
    count = surplus.size
    ends, room = neighbour.reshape(-1), residual.reshape(-1)
    # Level in the tree, 1 beside the sink and 0 outside; the pixels still to grow from, by their levels.
    level, parent = np.zeros(count, np.int32), np.full(count, _TO_SINK, np.int8)
    queue, waiting = np.empty(count + 1, np.int32), np.zeros(count, np.bool_)
    head, tail = 0, 0
    for first in range(count):
        if surplus[first] < 0:
            level[first], waiting[first], queue[tail] = 1, True, first
            tail += 1
    orphans = np.empty(count, np.int32)
    flow, depth = np.int64(0), 1
    while head != tail:
        last = tail
        while head != last:
            pixel = np.uint64(queue[head])
            head = head + 1 if head < count else 0
            if level[pixel] > depth:  # its level has risen since
                queue[tail] = pixel
                tail = tail + 1 if tail < count else 0
                continue
            waiting[pixel] = False
            for k in range(8):
                if level[pixel] != depth:
                    break
                edge = pixel << _EDGE_BITS | np.uint64(k)
                if ends[edge] < 0 or level[np.uint64(ends[edge])] > 0:
                    continue
                other = np.uint64(ends[edge])
                back = other << _EDGE_BITS | (np.uint64(k) ^ _OPPOSITE)
                while surplus[other] > 0 and room[back] > 0 and level[pixel] == depth:
                    amount = min(surplus[other], room[back])
                    amount, lost = _send(amount, pixel, ends, room, parent, surplus, orphans)
                    flow += amount
                    surplus[other] -= amount
                    room[back] -= amount
                    room[edge] += amount
                    if lost:
                        tail = _adopt(
                            lost, depth, (ends, room), (level, parent), orphans, (queue, waiting), tail
                        )
                if room[back] > 0 and level[pixel] == depth:
                    level[other], parent[other] = depth + 1, k ^ 4
                    if not waiting[other]:
                        waiting[other], queue[tail] = True, other
                        tail = tail + 1 if tail < count else 0
        depth += 1
    return flow, level > 0


@compiled
def _send(
    amount: int, pixel: np.uint64, ends: Array, room: Array, parent: Array, surplus: Array, orphans: Array
) -> tuple[int, int]:
    """Push up to an amount from a pixel of the tree to the sink; return how much arrived, and the number of
    pixels orphaned by it, the one nearest to the sink last."""
    place = pixel
    while parent[place] != _TO_SINK:
        up = place << _EDGE_BITS | np.uint64(parent[place])
        amount = min(amount, room[up])
        place = np.uint64(ends[up])
    amount = min(amount, -surplus[place])
    lost, place = 0, pixel
    while parent[place] != _TO_SINK:
        up = place << _EDGE_BITS | np.uint64(parent[place])
        above = np.uint64(ends[up])
        room[above << _EDGE_BITS | (np.uint64(parent[place]) ^ _OPPOSITE)] += amount
        room[up] -= amount
        if room[up] == 0:
            parent[place], orphans[lost] = _LOST, place
            lost += 1
        place = above
    surplus[place] += amount
    if surplus[place] == 0:
        parent[place], orphans[lost] = _LOST, place
        lost += 1
    return amount, lost


@compiled
def _adopt(
    lost: int, depth: int, edges: tuple[Array, Array], tree: tuple[Array, Array], orphans: Array,
    growing: tuple[Array, Array], tail: int,
) -> int:  # fmt: skip
    """Give each orphan, the last first, the parent that is nearest to the sink. If that raises its level, its
    children are orphaned too; if it would exceed the tree's depth, it leaves the tree."""
    (ends, room), (level, parent), (queue, waiting) = edges, tree, growing
    while lost > 0:
        lost -= 1
        orphan = np.uint64(orphans[lost])
        first = orphan << _EDGE_BITS
        nearest, least, wanted = _LOST, depth + 1, level[orphan] - 1
        for k in range(8):
            edge = first | np.uint64(k)
            if ends[edge] >= 0 and 0 < level[np.uint64(ends[edge])] < least and room[edge] > 0:
                nearest, least = k, level[np.uint64(ends[edge])]
                if least == wanted:
                    break
        parent[orphan] = nearest
        if least == wanted:
            continue
        level[orphan] = 0 if nearest == _LOST else least + 1
        if least == depth and not waiting[orphan]:
            waiting[orphan], queue[tail] = True, orphan
            tail = tail + 1 if tail < level.size else 0
        for k in range(8):
            child = ends[first | np.uint64(k)]
            if child >= 0 and parent[np.uint64(child)] == k ^ 4 and level[np.uint64(child)] > 0:
                parent[np.uint64(child)], orphans[lost] = _LOST, child
                lost += 1
    return tail
