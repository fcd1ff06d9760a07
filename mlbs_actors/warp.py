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
    source : (new height, new width) int64
        Raster index in the old region, −1 where the source is outside it or nothing describes it.
    new_residual : (new height, new width, 2) float32
        Residual (x, y) after the move, px; 0 where there is no source.

    Notes
    -----
    Backward warp of the appearance model, paper §6.1.
    """
    source = np.empty((new_region.height, new_region.width), np.int64)
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
    for y in range(source.shape[0]):
        for x in range(source.shape[1]):
            source_x = np.float64(x + shift_x) + motion[y, x, 0]
            source_y = np.float64(y + shift_y) + motion[y, x, 1]
            # Halves round upwards whatever the sign, so that a pan is treated alike everywhere.
            column, row = int(np.floor(source_x + 0.5)), int(np.floor(source_y + 0.5))
            if not (0 <= row < height and 0 <= column < width):
                source[y, x] = -1
                new_residual[y, x, 0], new_residual[y, x, 1] = 0.0, 0.0
                continue
            miss_x = column + residual[row, column, 0] - source_x
            miss_y = row + residual[row, column, 1] - source_y
            if max(abs(miss_x), abs(miss_y)) > 0.5:
                row, column, miss_x, miss_y = _search(residual, source_y, source_x, row, column)
            source[y, x] = row * width + column if row >= 0 else -1
            new_residual[y, x, 0], new_residual[y, x, 1] = miss_x, miss_y


@njit(cache=True)
def _search(
    residual: Array, source_y: float, source_x: float, row: int, column: int
) -> tuple[int, int, float, float]:
    """Row, column and miss (x, y) of the best stack when the one at the nearest pixel is not it."""
    height, width = residual.shape[0], residual.shape[1]
    guess_row = int(np.floor(source_y - residual[row, column, 1] + 0.5))
    guess_column = int(np.floor(source_x - residual[row, column, 0] + 0.5))
    if 0 <= guess_row < height and 0 <= guess_column < width:
        miss_x = guess_column + residual[guess_row, guess_column, 0] - source_x
        miss_y = guess_row + residual[guess_row, guess_column, 1] - source_y
        if max(abs(miss_x), abs(miss_y)) <= 0.5:
            return guess_row, guess_column, miss_x, miss_y
    # The residual jumps here (a border, a bend of the motion): look at all neighbours.
    best_row, best_column, best_x, best_y, best = -1, -1, 0.0, 0.0, MAX_MISS_PX**2
    for near_row in range(max(row - 1, 0), min(row + 2, height)):
        for near_column in range(max(column - 1, 0), min(column + 2, width)):
            miss_x = near_column + residual[near_row, near_column, 0] - source_x
            miss_y = near_row + residual[near_row, near_column, 1] - source_y
            miss = miss_x * miss_x + miss_y * miss_y
            if miss < best:
                best_row, best_column, best_x, best_y, best = near_row, near_column, miss_x, miss_y, miss
    return best_row, best_column, best_x, best_y


def warp_map(values: Array, old_region: Region, new_region: Region, motion: Array, neutral: float) -> Array:
    """Bilinear backward warp of a map by the layer's motion: prior_t(i) = posterior_{t−1}(i + m(i)).

    Parameters
    ----------
    values : (old height, old width) float32 or uint8
        The map of frame t−1 on the old region.
    old_region, new_region : Region
    motion : (new height, new width, 2) float32
        Backward motion t → t−1 at the pixels of the new region, px.
    neutral : float
        Value of everything outside the old region, in the map's unit.

    Returns
    -------
    (new height, new width) array of the same dtype
        uint8 maps are rounded to the nearest level.

    Notes
    -----
    Paper §6.1, with the delta approximation (variance of the motion taken as 0).
    """
    warped = np.empty((new_region.height, new_region.width), np.float32)
    _warp_bilinear(
        values, motion, new_region.x - old_region.x, new_region.y - old_region.y, float(neutral), warped
    )
    if values.dtype == np.uint8:
        rounded: Array = np.floor(warped + np.float32(0.5)).astype(np.uint8)
        return rounded
    return warped


@njit(cache=True)
def _warp_bilinear(
    values: Array, motion: Array, shift_x: int, shift_y: int, neutral: float, warped: Array
) -> None:
    height, width = values.shape
    for y in range(warped.shape[0]):
        for x in range(warped.shape[1]):
            source_x = np.float64(x + shift_x) + motion[y, x, 0]
            source_y = np.float64(y + shift_y) + motion[y, x, 1]
            if not (-1 < source_x < width and -1 < source_y < height):
                warped[y, x] = neutral
                continue
            left, top = int(np.floor(source_x)), int(np.floor(source_y))
            right_weight, bottom_weight = source_x - left, source_y - top
            total = 0.0
            for row, row_weight in ((top, 1.0 - bottom_weight), (top + 1, bottom_weight)):
                for column, column_weight in ((left, 1.0 - right_weight), (left + 1, right_weight)):
                    inside = 0 <= row < height and 0 <= column < width
                    value = np.float64(values[row, column]) if inside else np.float64(neutral)
                    total += row_weight * column_weight * value
            warped[y, x] = total
