"""Carries what a layer knows from frame t−1 to frame t along the layer's own motion (§6.1).

Two things are carried, in two ways:

* *Sample stacks* (the appearance model) are moved whole, never interpolated: :func:`nearest_sources` says
  for every pixel of frame t which stack of frame t−1 it takes over, and what is left of the sub-pixel part.
* *Smooth maps* (the prior) are interpolated bilinearly: :func:`warp_map`.

**The residual.** The stack stored at pixel j describes the surface point at j + r(j). Pixel i of frame t,
with backward motion m(i), looks for the point q = i + m(i). It takes the stack of the pixel j nearest to
q − r(round q), or of the best of the pixels around q if that one misses q by more than half a pixel, and
keeps r(i) = j + r(j) − q. What rounding loses in one frame is so made good in a later one: the stack stays
within about half a pixel of its point for ever (and within ``MAX_MISS_PX`` always), while rounding alone
drifts by up to half a pixel a frame and bilinear resampling blurs a little more every frame.

Differs from the paper: the paper's a_t(i) = a_{t−1}(φ(i, μ_i)) does not say how φ's fraction is treated.
A pixel whose source lies outside the old region has no stack, and a neutral prior; a map's pixels outside
the old region count as neutral in the interpolation, so that the warped map has no edge there.
The prior is resampled every frame and so blurs by a fraction of a pixel; it is made new from the posterior
of every frame, which restores its edges.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mlbs_actors.messages import Array, Region

__all__ = ["MAX_MISS_PX", "nearest_sources", "warp_map"]

#: A stack that describes a point this far from the source, px, is not taken over.
MAX_MISS_PX = 1.0


def nearest_sources(
    residual: Array, old_region: Region, new_region: Region, motion: Array
) -> tuple[Array, Array]:
    """Which stack of frame t−1 each pixel of frame t takes over, and its new residual.

    Parameters
    ----------
    residual : (old height, old width, 2) float32
        Sub-pixel residual (x, y) of the stacks of frame t−1, px.
    old_region, new_region : Region
        Where the stacks of frame t−1 and of frame t live in the frame.
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
    source = np.empty((new_region.height, new_region.width), np.int32)
    new_residual = np.empty((new_region.height, new_region.width, 2), np.float32)
    _find_sources(
        residual, motion, new_region.x - old_region.x, new_region.y - old_region.y, source, new_residual
    )
    return source, new_residual


@njit(cache=True)
def _find_sources(
    residual: Array, motion: Array, shift_x: int, shift_y: int, source: Array, new_residual: Array
) -> None:
    height, width = residual.shape[0], residual.shape[1]
    stored = residual.reshape(-1)
    half = np.float32(0.5)
    missed = np.empty(source.shape[1] + 1, np.uint64)
    # Indices that are known to be unsigned save the test for a negative one: a third of the time.
    for y in range(source.shape[0]):
        moves, sources, rests = motion[y].reshape(-1), source[y], new_residual[y].reshape(-1)
        count = 0
        for x in range(source.shape[1]):
            move_x, move_y = moves[np.uint64(2 * x)], moves[np.uint64(2 * x + 1)]
            # Halves round upwards whatever the sign, so that a pan is treated alike everywhere.
            whole_x, whole_y = np.floor(move_x + half), np.floor(move_y + half)
            column, row = x + shift_x + int(whole_x), y + shift_y + int(whole_y)
            if not (0 <= row < height and 0 <= column < width):
                sources[np.uint64(x)] = -1
                rests[np.uint64(2 * x)], rests[np.uint64(2 * x + 1)] = np.float32(0), np.float32(0)
                continue
            # q lies this far from the nearest pixel. Exact in single precision, as q itself is not.
            part_x, part_y = move_x - whole_x, move_y - whole_y
            place = row * width + column
            step_x = np.floor(part_x - stored[np.uint64(2 * place)] + half)
            step_y = np.floor(part_y - stored[np.uint64(2 * place + 1)] + half)
            near_column, near_row = column + int(step_x), row + int(step_y)
            if not (0 <= near_row < height and 0 <= near_column < width):
                step_x, step_y, near_column, near_row = np.float32(0), np.float32(0), column, row
            place = near_row * width + near_column
            miss_x = step_x + stored[np.uint64(2 * place)] - part_x
            miss_y = step_y + stored[np.uint64(2 * place + 1)] - part_y
            sources[np.uint64(x)] = place
            rests[np.uint64(2 * x)], rests[np.uint64(2 * x + 1)] = miss_x, miss_y
            missed[np.uint64(count)] = x  # kept if it counts: a branch would be mispredicted
            count += int(max(abs(miss_x), abs(miss_y)) > half)
        for i in range(count):
            x = int(missed[i])
            whole_x, whole_y = np.floor(motion[y, x, 0] + half), np.floor(motion[y, x, 1] + half)
            place, miss_x, miss_y = _best_around(
                stored,
                height,
                width,
                y + shift_y + int(whole_y),
                x + shift_x + int(whole_x),
                motion[y, x, 0] - whole_x,
                motion[y, x, 1] - whole_y,
            )
            if miss_x * miss_x + miss_y * miss_y >= np.float32(MAX_MISS_PX**2):
                place, miss_x, miss_y = -1, np.float32(0), np.float32(0)
            source[y, x] = place
            new_residual[y, x, 0], new_residual[y, x, 1] = miss_x, miss_y


@njit(cache=True)
def _best_around(
    stored: Array, height: int, width: int, row: int, column: int, part_x: np.float32, part_y: np.float32
) -> tuple[int, np.float32, np.float32]:
    """Index and miss of the best stack where the residual jumps: at a border, or a bend of the motion."""
    best_place, best = 0, np.float32(np.inf)
    best_x, best_y = np.float32(0), np.float32(0)
    for v in range(-1, 2):  # of fixed length and without a branch: this is half of the time
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
    """Bilinear backward warp of a map by the layer's motion: prior_t(i) = posterior_{t−1}(i + m(i)).

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
    _warp_bilinear(
        values, motion, new_region.x - old_region.x, new_region.y - old_region.y, needed, value, share
    )
    return value, share


@njit(cache=True)
def _warp_bilinear(
    values: Array, motion: Array, shift_x: int, shift_y: int, needed: Array, value: Array, share: Array
) -> None:
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
