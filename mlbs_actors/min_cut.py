"""Minimum cut of a graph of pixels by the algorithm of Boykov and Kolmogorov (PAMI 2004).

Two trees of unsaturated edges grow from the terminals until they meet; the path is saturated; what it cut off
looks for a new parent. Distances to the terminals are kept with time stamps, as in the authors' program,
so that paths are short and parents are found fast. What lies on the sink's side is the smallest such set.

Differs from the authors' program: no edge is stored. Pixels have eight neighbours, and the edge to the k-th
is the opposite of that neighbour's edge to its own (k + 4 mod 8)-th. The few bytes a pixel matter: most of
the time that a general graph takes goes into getting and filling its memory.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = ["min_cut"]

#: What a pixel's parent can be besides one of its neighbours: nothing (it is free), the terminal, or lost.
_NONE, _TERMINAL, _LOST = -1, -2, -3
_FAR = 2**30


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
    from_sink = surplus < 0  # tree of a pixel that has a parent
    parent = np.where(surplus != 0, _TERMINAL, _NONE).astype(np.int8)
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
                return flow, from_sink & (parent != _NONE)
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
        tail, bridge = (neighbour[current, meeting], meeting ^ 4) if backward else (current, meeting)
        top = neighbour[tail, bridge]
        amount = min(residual[tail, bridge], _supply(tail, neighbour, residual, parent, surplus))
        amount = min(amount, _demand(top, neighbour, residual, parent, surplus))
        flow += amount
        residual[tail, bridge] -= amount
        residual[top, bridge ^ 4] += amount
        lost_begin, lost_end = 0, 0
        for to_sink in range(2):
            pixel = top if to_sink else tail
            while True:
                up = parent[pixel]
                if up == _TERMINAL:
                    surplus[pixel] += amount if to_sink else -amount
                    full = surplus[pixel] == 0
                    above = pixel
                else:
                    above = neighbour[pixel, up]
                    residual[pixel, up] += -amount if to_sink else amount
                    residual[above, up ^ 4] += amount if to_sink else -amount
                    full = (residual[pixel, up] if to_sink else residual[above, up ^ 4]) == 0
                if full:
                    parent[pixel] = _LOST
                    orphans[lost_end] = pixel
                    lost_end += 1
                if up == _TERMINAL:
                    break
                pixel = above

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
                    far = _distance(other, neighbour, parent, stamp, distance, time)
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
def _supply(pixel: int, neighbour: Array, residual: Array, parent: Array, surplus: Array) -> np.int32:
    """What can flow from the source to a pixel of its tree."""
    least = np.int32(_FAR)
    while parent[pixel] != _TERMINAL:
        above = neighbour[pixel, parent[pixel]]
        least = min(least, residual[above, parent[pixel] ^ 4])
        pixel = above
    return np.int32(min(least, surplus[pixel]))


@compiled()
def _demand(pixel: int, neighbour: Array, residual: Array, parent: Array, surplus: Array) -> np.int32:
    """What can flow from a pixel of the sink's tree to the sink."""
    least = np.int32(_FAR)
    while parent[pixel] != _TERMINAL:
        least = min(least, residual[pixel, parent[pixel]])
        pixel = neighbour[pixel, parent[pixel]]
    return np.int32(min(least, -surplus[pixel]))


@compiled()
def _distance(start: int, neighbour: Array, parent: Array, stamp: Array, distance: Array, time: int) -> int:
    """Distance of a pixel to its terminal, stamped on the way there; far if the way leads to an orphan."""
    pixel, steps = start, 0
    while stamp[pixel] != time:
        if parent[pixel] == _TERMINAL:
            stamp[pixel], distance[pixel] = time, 1
            break
        if parent[pixel] == _LOST:
            return _FAR
        pixel = neighbour[pixel, parent[pixel]]
        steps += 1
    total = steps + int(distance[pixel])
    pixel, left = start, total
    while stamp[pixel] != time:
        stamp[pixel], distance[pixel] = time, left
        left -= 1
        pixel = neighbour[pixel, parent[pixel]]
    return total
