"""Minimum cut of a graph of pixels by the algorithm of Boykov and Kolmogorov (PAMI 2004).

Two trees of unsaturated edges grow from the terminals until they meet; the path is saturated; what it cut off
looks for a new parent. Distances to the terminals are kept with time stamps, as in the authors' program,
so that paths are short and parents are found fast. What lies on the sink's side is the smallest such set.

Differs from the authors' program: no edge is stored. Pixels have eight neighbours, and the edge to the k-th
is the opposite of that neighbour's edge to its own (k + 4 mod 8)-th. The few bytes a pixel matter: most of
the time that a general graph takes goes into getting and filling its memory. Along a path every index waits
for the one before, and a signed one also for the look whether it counts from the end: theirs are unsigned.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = ["min_cut"]

#: What a pixel's parent can be besides one of its neighbours: nothing (it is free), the terminal, or lost.
_NONE, _TERMINAL, _LOST = -1, -2, -3
_FAR = 2**30
#: An edge's number but for this bit is that of the way back.
_OPPOSITE = np.uint64(4)


@compiled()
def min_cut(surplus: Array, neighbour: Array, residual: Array) -> tuple[np.int64, Array]:
    """Cut a graph of n pixels.

    Parameters
    ----------
    surplus : (n,) int32
        Capacity from the source less that to the sink; afterwards what is left of it.
    neighbour : (n, 8) int32
        Pixels that edges lead to: that of entry k has this one as its entry (k + 4) mod 8. −1 if there is
        none.
    residual : (n, 8) int32
        Capacities of the edges, ≥ 0, and 0 where there is none; afterwards what is left of them.

    Returns
    -------
    flow : int
        Weight of the minimum cut.
    on_sink_side : (n,) bool
    """
    count = surplus.size
    flow = np.int64(0)
    from_sink = np.empty(count, np.bool_)  # tree of a pixel that has a parent
    parent = np.empty(count, np.int8)
    for pixel in range(count):
        from_sink[pixel] = surplus[pixel] < 0
        parent[pixel] = _TERMINAL if surplus[pixel] != 0 else _NONE
    distance, stamp = np.ones(count, np.int32), np.zeros(count, np.int32)
    time = 0
    active, waiting = np.empty(count + 1, np.int32), np.zeros(count, np.bool_)
    begin, end = 0, 0
    for pixel in range(count):
        if parent[pixel] == _NONE:
            continue
        for k in range(8):  # inside a tree there is nothing to grow into
            other = neighbour[pixel, k]
            if other >= 0 and (parent[other] == _NONE or from_sink[other] != from_sink[pixel]):
                waiting[pixel] = True
                active[end] = pixel
                end += 1
                break
    orphans = np.empty(count + 1, np.int32)

    current = -1
    while True:
        if current < 0 or parent[current] == _NONE:
            if begin == end:
                for pixel in range(count):
                    from_sink[pixel] &= parent[pixel] != _NONE
                return flow, from_sink
            current = active[begin]
            begin = begin + 1 if begin < count else 0
            waiting[current] = False
            if parent[current] == _NONE:
                continue

        # Grow the tree at this pixel until it meets the other tree.
        backward = from_sink[current]
        meeting = -1
        for k in range(8):
            other = neighbour[current, k]
            if other < 0 or (residual[other, k ^ 4] if backward else residual[current, k]) == 0:
                continue
            if parent[other] == _NONE:
                from_sink[other] = backward
                parent[other] = k ^ 4
                stamp[other], distance[other] = stamp[current], distance[current] + 1
                if not waiting[other]:
                    waiting[other] = True
                    active[end] = other
                    end = end + 1 if end < count else 0
            elif from_sink[other] != backward:
                meeting = k
                break
            elif stamp[other] <= stamp[current] and distance[other] > distance[current]:
                parent[other] = k ^ 4  # nearer to the terminal
                stamp[other], distance[other] = stamp[current], distance[current] + 1
        time += 1
        if meeting < 0:
            current = -1
            continue

        # Saturate the path; pixels beyond a full edge lose their parent.
        edge, back = np.uint64(meeting), np.uint64(meeting ^ 4)
        source_end, sink_end = np.uint64(current), np.uint64(neighbour[current, edge])
        if backward:
            source_end, sink_end, edge, back = sink_end, source_end, back, edge
        amount = min(residual[source_end, edge], _supply(source_end, neighbour, residual, parent, surplus))
        amount = min(amount, _demand(sink_end, neighbour, residual, parent, surplus))
        flow += amount
        residual[source_end, edge] -= amount
        residual[sink_end, back] += amount
        lost_begin, lost_end = 0, 0
        for to_sink in range(2):
            place = sink_end if to_sink else source_end
            down, up = (amount, -amount) if to_sink else (-amount, amount)
            while parent[place] != _TERMINAL:
                edge = np.uint64(parent[place])
                above, back = np.uint64(neighbour[place, edge]), edge ^ _OPPOSITE
                residual[place, edge] += up
                residual[above, back] += down
                if (residual[place, edge] if to_sink else residual[above, back]) == 0:
                    parent[place] = _LOST
                    orphans[lost_end] = place
                    lost_end += 1
                place = above
            surplus[place] += down
            if surplus[place] == 0:
                parent[place] = _LOST
                orphans[lost_end] = place
                lost_end += 1

        # Each orphan takes the parent nearest to the terminal, or becomes free and orphans its children.
        while lost_begin != lost_end:
            pixel = orphans[lost_begin]
            lost_begin = lost_begin + 1 if lost_begin < count else 0
            backward = from_sink[pixel]
            nearest, least = _NONE, _FAR
            for k in range(8):
                other = neighbour[pixel, k]
                if other < 0 or parent[other] == _NONE or from_sink[other] != backward:
                    continue
                if (residual[pixel, k] if backward else residual[other, k ^ 4]) > 0:
                    far = _distance(np.uint64(other), neighbour, parent, stamp, distance, time)
                    if far < least:
                        nearest, least = k, far
            parent[pixel] = nearest
            if nearest != _NONE:
                stamp[pixel], distance[pixel] = time, least + 1
                continue
            for k in range(8):
                other = neighbour[pixel, k]
                if other < 0 or parent[other] == _NONE or from_sink[other] != backward:
                    continue
                if (residual[pixel, k] if backward else residual[other, k ^ 4]) > 0 and not waiting[other]:
                    waiting[other] = True
                    active[end] = other
                    end = end + 1 if end < count else 0
                if parent[other] == k ^ 4:
                    parent[other] = _LOST
                    orphans[lost_end] = other
                    lost_end = lost_end + 1 if lost_end < count else 0


@compiled()
def _supply(pixel: np.uint64, neighbour: Array, residual: Array, parent: Array, surplus: Array) -> np.int32:
    """What can flow from the source to a pixel of its tree."""
    least = np.int32(_FAR)
    while parent[pixel] != _TERMINAL:
        edge = np.uint64(parent[pixel])
        pixel = np.uint64(neighbour[pixel, edge])
        least = min(least, residual[pixel, edge ^ _OPPOSITE])
    return np.int32(min(least, surplus[pixel]))


@compiled()
def _demand(pixel: np.uint64, neighbour: Array, residual: Array, parent: Array, surplus: Array) -> np.int32:
    """What can flow from a pixel of the sink's tree to the sink."""
    least = np.int32(_FAR)
    while parent[pixel] != _TERMINAL:
        edge = np.uint64(parent[pixel])
        least = min(least, residual[pixel, edge])
        pixel = np.uint64(neighbour[pixel, edge])
    return np.int32(min(least, -surplus[pixel]))


@compiled()
def _distance(
    start: np.uint64, neighbour: Array, parent: Array, stamp: Array, distance: Array, time: int
) -> int:
    """Distance of a pixel to its terminal, stamped on the way there; far if the way leads to an orphan."""
    pixel, steps = start, 0
    while stamp[pixel] != time:
        if parent[pixel] == _TERMINAL:
            stamp[pixel], distance[pixel] = time, 1
            break
        if parent[pixel] == _LOST:
            return _FAR
        pixel = np.uint64(neighbour[pixel, np.uint64(parent[pixel])])
        steps += 1
    total = steps + int(distance[pixel])
    pixel, left = start, total
    while stamp[pixel] != time:
        stamp[pixel], distance[pixel] = time, left
        left -= 1
        pixel = np.uint64(neighbour[pixel, np.uint64(parent[pixel])])
    return total
