"""Warps a layer's model from frame t−1 to frame t along the layer's own motion (§6.1).

Two things are warped in two ways:

* *Sample stacks* (the appearance model) are moved whole, never interpolated: :func:`nearest_sources` gives
  for every pixel of frame t the stack of frame t−1 that it takes over, and the sub-pixel remainder.
* *Smooth maps* (the prior) are interpolated bilinearly: :func:`warp_map`.

**The residual.** The stack stored at pixel j describes the surface point at j + r(j). Pixel i of frame t,
with backward motion m(i), looks for the point q = i + m(i). It takes the stack of the pixel j nearest to
q − r(round q), or of the best of the pixels around q if that one misses q by more than half a pixel, and
keeps r(i) = j + r(j) − q. So what rounding loses in one frame is recovered in a later one: the stack stays
within about half a pixel of its point for ever (and within ``MAX_MISS_PX`` always), while rounding alone
drifts by up to half a pixel a frame and bilinear resampling blurs a little more every frame.

Differs from the paper: the paper's a_t(i) = a_{t−1}(φ(i, μ_i)) does not say how φ's fraction is treated. A
pixel whose source lies outside the old region has no stack, and a neutral prior; a map's pixels outside the
old region count as neutral in the interpolation, so that the warped map has no edge there. The prior is
resampled every frame and so blurs by a fraction of a pixel; it is recomputed from the posterior of every
frame, which restores its edges.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.messages import Array, Region

__all__ = ["MAX_MISS_PX", "interpolate_map", "nearest_sources", "warp_map"]

#: A stack that describes a point this far from the source, px, is not taken over.
MAX_MISS_PX = 1.0


@compiled
def nearest_sources(residual: Array, shift_x: int, shift_y: int, motion: Array) -> tuple[Array, Array]:
    """Find the stack of frame t−1 that each pixel of frame t takes over, and its new residual.

    Parameters
    ----------
    residual : (old height, old width, 2) float32
        Sub-pixel residual (x, y) of the stacks of frame t−1, px.
    shift_x, shift_y : int
        Where the stacks of frame t begin, relative to those of frame t−1, px.
    motion : (new height, new width, 2) float32
        The layer's backward motion t → t−1 at the pixels of the new region, px.

    Returns
    -------
    source : (new height, new width) int32
        Raster index in the old region, −1 where the source is outside it or nothing describes it.
    new_residual : (new height, new width, 2) float32
        Residual (x, y) after the move, px; 0 where there is no source.

    Notes
    -----
    Backward warp of the appearance model, paper §6.1.
    """
    source, new_residual = np.empty(motion.shape[:2], np.int32), np.empty(motion.shape, np.float32)
    if residual.size == 0:
        source[:] = -1
        new_residual[:] = 0
    else:
        _find_sources(residual, motion, shift_x, shift_y, source, new_residual)
    return source, new_residual


@compiled
def _find_sources(
    residual: Array, motion: Array, shift_x: int, shift_y: int, source: Array, new_residual: Array
) -> None:
    stored, half, zero = residual.reshape(-1), np.float32(0.5), np.float32(0)
    height, width = np.int32(residual.shape[0]), np.int32(residual.shape[1])
    count = source.shape[1]
    column, row, place = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    # x and y, one after the other: fractions of a pixel, steps to the stack, and that stack's residual.
    part, step = np.empty((2, count), np.float32), np.empty((2, count), np.float32)
    rest, inside = np.empty((2, count), np.float32), np.empty(count, np.bool_)
    missed = np.empty(count + 1, np.int32)
    all_moves, all_rests, pair = motion.reshape(-1), new_residual.reshape(-1), 2 * count
    # Loops without a branch, and in 32 bits, are vectorised.
    for y in range(source.shape[0]):
        begin, end, sources = y * pair, (y + 1) * pair, source[y]
        moves, rests = all_moves[begin:end], all_rests[begin:end]
        for x in range(count):
            move_x, move_y = moves[np.uint64(2 * x)], moves[np.uint64(2 * x + 1)]
            # Halves round up whatever the sign, so that a pan is treated alike everywhere.
            whole_x, whole_y = np.floor(move_x + half), np.floor(move_y + half)
            # Distance of q from the nearest pixel: exact in single precision, as q itself is not.
            part[0, x], part[1, x] = move_x - whole_x, move_y - whole_y
            column[x] = np.int32(x + shift_x) + np.int32(whole_x)
            row[x] = np.int32(y + shift_y) + np.int32(whole_y)
            inside[x] = _is_inside(column[x], row[x], width, height)
            place[x] = row[x] * width + column[x] if inside[x] else np.int32(0)
        _gather(stored, place, rest)
        for x in range(count):
            step_x = np.floor(part[0, x] - rest[0, x] + half)
            step_y = np.floor(part[1, x] - rest[1, x] + half)
            near_column, near_row = column[x] + np.int32(step_x), row[x] + np.int32(step_y)
            near = inside[x] & _is_inside(near_column, near_row, width, height)
            place[x] = near_row * width + near_column if near else place[x]
            step[0, x], step[1, x] = step_x if near else zero, step_y if near else zero
        _gather(stored, place, rest)
        for x in range(count):
            miss_x, miss_y = step[0, x] + rest[0, x] - part[0, x], step[1, x] + rest[1, x] - part[1, x]
            sources[x] = place[x] if inside[x] else np.int32(-1)
            rests[np.uint64(2 * x)] = miss_x if inside[x] else zero
            rests[np.uint64(2 * x + 1)] = miss_y if inside[x] else zero
        found = 0
        for x in range(count):
            missed[found] = x  # kept if it counts; a branch would be mispredicted
            found += int(max(abs(rests[np.uint64(2 * x)]), abs(rests[np.uint64(2 * x + 1)])) > half)
        for i in range(found):
            x = missed[i]
            best, miss_x, miss_y = _best_around(
                stored, int(height), int(width), row[x], column[x], part[0, x], part[1, x]
            )
            if miss_x * miss_x + miss_y * miss_y >= np.float32(MAX_MISS_PX**2):
                best, miss_x, miss_y = -1, zero, zero
            sources[x] = best
            rests[2 * x], rests[2 * x + 1] = miss_x, miss_y


@inlined
def _is_inside(column: np.int32, row: np.int32, width: np.int32, height: np.int32) -> bool:
    return bool((column >= 0) & (column < width) & (row >= 0) & (row < height))


@compiled
def _gather(stored: Array, places: Array, rest: Array) -> None:
    """Read stored residuals (x and y alternating) at some places, into (2, n)."""
    for i in range(places.size):
        place = np.uint64(np.uint32(places[i]))
        rest[0, i] = stored[place * np.uint64(2)]
        rest[1, i] = stored[place * np.uint64(2) + np.uint64(1)]


@compiled
def _best_around(
    stored: Array, height: int, width: int, row: int, column: int, part_x: np.float32, part_y: np.float32
) -> tuple[int, np.float32, np.float32]:
    """Return index and miss of the best stack where the residual jumps: at a border or a bend of motion."""
    best_place, best = 0, np.float32(np.inf)
    best_x, best_y = np.float32(0), np.float32(0)
    for v in range(-1, 2):  # branch-free and of fixed length: this is half of the time
        near_row = min(max(row + v, 0), height - 1)
        for u in range(-1, 2):
            near_column = min(max(column + u, 0), width - 1)
            place = near_row * width + near_column
            miss_x = np.float32(near_column - column) + stored[np.uint64(2 * place)] - part_x
            miss_y = np.float32(near_row - row) + stored[np.uint64(2 * place + 1)] - part_y
            miss = miss_x * miss_x + miss_y * miss_y
            better = miss < best
            best_place = place if better else best_place
            best_x, best_y = miss_x if better else best_x, miss_y if better else best_y
            best = min(miss, best)
    return best_place, best_x, best_y


def warp_map(
    values: Array, old_region: Region, new_region: Region, motion: Array, needed: Array
) -> tuple[Array, Array]:
    """Warp a map backward, bilinearly, by the layer's motion: prior_t(i) = posterior_{t−1}(i + m(i)).

    Parameters
    ----------
    values : (old height, old width) float32
        The map of frame t−1 on the old region.
    old_region, new_region : Region
    motion : (new height, new width, 2) float32
        Backward motion t → t−1 at the pixels of the new region, px.
    needed : (new height, new width) bool
        Where to warp it; both results are 0 elsewhere.

    Returns
    -------
    value : (new height, new width) float32
        Everything outside the old region taken as 0.
    share : (new height, new width) float32
        How much of the value comes from inside the old region, in [0, 1]: with a neutral value n outside, the
        map is ``value + (1 − share) n``.

    Notes
    -----
    Paper §6.1, with the delta approximation (variance of the motion taken as 0).
    """
    value, share = np.zeros(needed.shape, np.float32), np.zeros(needed.shape, np.float32)
    interpolate_map(
        values, motion, new_region.x - old_region.x, new_region.y - old_region.y, needed, value, share
    )
    return value, share


@compiled
def interpolate_map(
    values: Array, motion: Array, shift_x: int, shift_y: int, needed: Array, value: Array, share: Array
) -> None:
    """Apply :func:`warp_map` into zeros, from a region offset by this from the new one's corner."""
    height, width = values.shape
    one = np.float32(1)
    for y in range(needed.shape[0]):
        for x in range(needed.shape[1]):
            if not needed[y, x]:
                continue
            whole_x, whole_y = np.floor(motion[y, x, 0]), np.floor(motion[y, x, 1])
            left, top = x + shift_x + int(whole_x), y + shift_y + int(whole_y)
            along, down = motion[y, x, 0] - whole_x, motion[y, x, 1] - whole_y
            if 0 <= left < width - 1 and 0 <= top < height - 1:
                above = (one - along) * values[top, left] + along * values[top, left + 1]
                below = (one - along) * values[top + 1, left] + along * values[top + 1, left + 1]
                value[y, x], share[y, x] = (one - down) * above + down * below, one
                continue
            for row, row_share in ((top, one - down), (top + 1, down)):
                for column, column_share in ((left, one - along), (left + 1, along)):
                    if 0 <= row < height and 0 <= column < width:
                        value[y, x] += row_share * column_share * values[row, column]
                        share[y, x] += row_share * column_share
