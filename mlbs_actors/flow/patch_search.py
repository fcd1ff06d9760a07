"""The motion of small patches of one level, by search and inverse-compositional descent.

Patches on a grid start from the current flow or from that of a neighbour, whichever explains the image
better, and descend from there. Each pixel then takes the mean motion of the patches over it, those that
explain it well counting most (:mod:`mlbs_actors.flow.inverse_search` says where this comes from).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.kernels.simd import absolute, broadcast, load, maximum, multiply_add, store, sum_of_lanes
from mlbs_actors.messages import Array

__all__ = ["MARGIN", "PATCH", "densify", "patch_places", "search_patches"]

#: Side of a patch, px.
PATCH = 8
#: Pixels of padding around a frame: a patch may leave it altogether.
MARGIN = 16
#: Rows of patches that are searched together, so that the pixels of a diagonal stay in the innermost cache.
STRIP = 8


class _Pair(NamedTuple):
    """A level of two frames, as flat arrays, where a pixel's place is one sum.

    Attributes
    ----------
    gray : (h · w,)
        The frame that the patches are from.
    around : ((h + 2 MARGIN) · (w + 2 MARGIN),)
        The frame where they are searched, padded.
    slope_x, slope_y : (h · w,)
        Of the former.
    shape : (int, int)
        (h, w).
    """

    gray: Array
    around: Array
    slope_x: Array
    slope_y: Array
    shape: tuple[int, int]


@compiled
def patch_places(start: int, length: int, stride: int) -> Array:
    """Return where patches begin along one axis; the last one ends where the part does."""
    last = start + length - PATCH
    return np.minimum(np.arange(start, last + stride, stride), last)


@compiled
def search_patches(
    gray: Array, around: Array, slope_x: Array, slope_y: Array, flow: Array, across: Array, down: Array,
    iterations: int,
) -> Array:  # fmt: skip
    """Find the motion of each patch, (rows, columns, 2), in two passes: from the top left, and back."""
    rows, columns = down.size, across.size
    pair = _Pair(gray.reshape(-1), around.reshape(-1), slope_x.reshape(-1), slope_y.reshape(-1), gray.shape)
    motions = np.empty((rows, columns, 2), np.float32)
    slopes = np.empty((rows, columns, 5), np.float32)
    for row in range(rows):
        for column in range(columns):
            y, x = down[row], across[column]
            slopes[row, column] = _slopes(pair, y, x)
            for axis in range(2):
                motions[row, column, axis] = flow[axis, y + PATCH // 2, x + PATCH // 2]
    for step in (1, -1):
        _pass(pair, motions[::step, ::step], slopes[::step, ::step], across[::step], down[::step], iterations)
    return motions


@compiled
def _pass(pair: _Pair, motions: Array, slopes: Array, across: Array, down: Array, iterations: int) -> None:
    """Search every patch from its own motion or that of the one before it in its row or column, in place.

    Patches on a diagonal do not depend on each other and are interleaved step by step: the sums of a single
    one would leave the processor idle for most of the time.
    """
    rows, columns = motions.shape[:2]
    us, vs, mismatch = np.empty(STRIP, np.float32), np.empty(STRIP, np.float32), np.empty(STRIP, np.float32)
    descending = np.empty(STRIP, np.int64)
    for top in range(0, rows, STRIP):
        height = min(STRIP, rows - top)
        for diagonal in range(height + columns - 1):
            first, end = max(0, diagonal - columns + 1), min(diagonal + 1, height)
            for k in range(first, end):
                row, column = top + k, diagonal - k
                y, x = down[row], across[column]
                u, v = motions[row, column, 0], motions[row, column, 1]
                least = _mismatch(pair, y, x, u, v)
                for other_row, other_column in ((row, max(column - 1, 0)), (max(row - 1, 0), column)):
                    other_u = motions[other_row, other_column, 0]
                    other_v = motions[other_row, other_column, 1]
                    other = _mismatch(pair, y, x, other_u, other_v)
                    better = other < least  # branch-free, as it would be mispredicted
                    least = other if better else least
                    u = other_u if better else u
                    v = other_v if better else v
                motions[row, column, 0], motions[row, column, 1] = u, v
                us[k], vs[k], mismatch[k], descending[k - first] = u, v, np.float32(np.inf), k
            left = end - first
            for _ in range(iterations):
                count, left = left, 0
                for place in range(count):
                    k = descending[place]
                    row, column = top + k, diagonal - k
                    u, v, now = _descended(pair, down[row], across[column], us[k], vs[k], slopes[row, column])
                    descending[left] = k
                    left += now < mismatch[k]
                    us[k], vs[k], mismatch[k] = u, v, now
            for k in range(first, end):
                row, column = top + k, diagonal - k
                away_u, away_v = us[k] - motions[row, column, 0], vs[k] - motions[row, column, 1]
                # A patch that ends far from where it began has lost its way.
                if away_u**2 + away_v**2 <= np.float32(PATCH * PATCH):
                    motions[row, column, 0], motions[row, column, 1] = us[k], vs[k]


# The functions below are inlined: calls would move more arguments than a patch has rows.


@inlined
def _descended(
    pair: _Pair, y: int, x: int, u: np.float32, v: np.float32, slopes: Array
) -> tuple[np.float32, np.float32, np.float32]:
    """Take one step of inverse-compositional descent, brightness aside; return motion and last mismatch.

    Sobel's slopes are eight times the derivatives, so a step is an eighth of a Gauss–Newton step. With full
    steps more patches lose their way.
    """
    xx, xy, yy, sum_x, sum_y = slopes[0], slopes[1], slopes[2], slopes[3], slopes[4]
    determinant = max(xx * yy - xy * xy, np.float32(1e-3))
    total, squares, along, below = _differences(pair, y, x, u, v)
    mean = total / np.float32(PATCH * PATCH)
    gradient_x, gradient_y = along - mean * sum_x, below - mean * sum_y
    u -= (yy * gradient_x - xy * gradient_y) / determinant
    v -= (xx * gradient_y - xy * gradient_x) / determinant
    return u, v, squares - mean * total


@inlined
def _source_place(
    shape: tuple[int, int], y: int, x: int, u: np.float32, v: np.float32
) -> tuple[np.uint64, np.float32, np.float32]:
    """Return where a moved patch begins in the padded frame, and the fractions of a pixel left over."""
    least = np.float32(MARGIN - PATCH + 1)
    bottom, right = np.float32(shape[0] + MARGIN - 1), np.float32(shape[1] + MARGIN - 1)
    at_y = min(max(np.float32(y + MARGIN) + v, least), bottom)
    at_x = min(max(np.float32(x + MARGIN) + u, least), right)
    top, left = np.int32(at_y), np.int32(at_x)
    down, across = at_y - np.float32(top), at_x - np.float32(left)
    there = np.uint64(top * (shape[1] + 2 * MARGIN) + left)
    return there, across, down


@inlined
def _place(width: int, y: int, x: int, row: int, column: int) -> np.uint64:
    """Return the flat index of a patch's pixel."""
    return (
        np.uint64(y) * np.uint64(width) + np.uint64(x) + np.uint64(row) * np.uint64(width) + np.uint64(column)
    )


@inlined
def _slopes(pair: _Pair, y: int, x: int) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Sum the slopes' squares and product, and the slopes, over a patch."""
    xx, xy, yy, sum_x, sum_y = np.int32(0), np.int32(0), np.int32(0), np.int32(0), np.int32(0)
    # Columns are the outer loop: LLVM unrolls the rows, and does all columns at once. Sums of integers may be
    # added in any order.
    for column in range(PATCH):
        for row in range(PATCH):
            at = _place(pair.shape[1], y, x, row, column)
            along, below = np.int32(pair.slope_x[at]), np.int32(pair.slope_y[at])
            xx, xy, yy = (
                np.int32(xx + along * along),
                np.int32(xy + along * below),
                np.int32(yy + below * below),
            )
            sum_x, sum_y = np.int32(sum_x + along), np.int32(sum_y + below)
    return np.float32(xx), np.float32(xy), np.float32(yy), np.float32(sum_x), np.float32(sum_y)


@inlined
def _mismatch(pair: _Pair, y: int, x: int, u: np.float32, v: np.float32) -> np.float32:
    """Sum the squared differences of a patch and its place in the target, less their mean."""
    width = pair.shape[1]
    there, across, down = _source_place(pair.shape, y, x, u, v)
    here, upper = _place(width, y, x, 0, 0), _between(pair.around, there, across)
    summed = broadcast(np.float32(0), PATCH)
    squares = summed
    for _ in range(PATCH):
        there += np.uint64(width + 2 * MARGIN)
        lower = _between(pair.around, there, across)
        difference = _row_difference(pair.gray, here, upper, lower, down)
        summed, squares = summed + difference, multiply_add(difference, difference, squares)
        here, upper = here + np.uint64(width), lower
    plain, squared = np.float32(sum_of_lanes(summed)), np.float32(sum_of_lanes(squares))
    mean = plain / np.float32(PATCH * PATCH)
    return squared - mean * plain


@inlined
def _differences(
    pair: _Pair, y: int, x: int, u: np.float32, v: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Sum a patch's differences: plain, squared, times its slope along x, and along y."""
    width = pair.shape[1]
    there, across, down = _source_place(pair.shape, y, x, u, v)
    here, upper = _place(width, y, x, 0, 0), _between(pair.around, there, across)
    summed = broadcast(np.float32(0), PATCH)
    squares, along, below = summed, summed, summed
    for _ in range(PATCH):
        there += np.uint64(width + 2 * MARGIN)
        lower = _between(pair.around, there, across)
        difference = _row_difference(pair.gray, here, upper, lower, down)
        summed, squares = summed + difference, multiply_add(difference, difference, squares)
        along = multiply_add(difference, load(pair.slope_x, here, PATCH), along)
        below = multiply_add(difference, load(pair.slope_y, here, PATCH), below)
        here, upper = here + np.uint64(width), lower
    return sum_of_lanes(summed), sum_of_lanes(squares), sum_of_lanes(along), sum_of_lanes(below)


@inlined
def _row_difference(gray: Array, here: np.uint64, upper: Any, lower: Any, down: np.float32) -> Any:
    """Return the interpolated difference between a row of the padded target and a patch's row."""
    moved = multiply_add(broadcast(down, PATCH), lower - upper, upper)
    return moved - load(gray, here, PATCH)


@compiled
def densify(
    gray: Array,
    around: Array,
    motions: Array,
    across: Array,
    down: Array,
    left: int,
    top: int,
    window: Array,
) -> None:
    """Add the motion of the patches over each pixel to (3, h, w) zeros: x, y and the sum of weights.

    A patch weighs 1 / its difference there in grey levels, at most 1.
    """
    shape, width = gray.shape, window.shape[2]
    stride, continued = np.uint64(shape[1]), np.uint64(shape[1] + 2 * MARGIN)
    gray, around, sums = gray.reshape(-1), around.reshape(-1), window.reshape(-1)
    one = broadcast(np.float32(1), PATCH)
    for row in range(down.size):
        for column in range(across.size):
            y, x = down[row], across[column]
            u, v = motions[row, column, 0], motions[row, column, 1]
            there, right, lower = _source_place(shape, y, x, u, v)
            upper = _between(around, there, right)
            here, to = _place(shape[1], y, x, 0, 0), _place(width, y - top, x - left, 0, 0)
            for _ in range(PATCH):
                there += continued
                below = _between(around, there, right)
                error = absolute(_row_difference(gray, here, upper, below, lower))
                weight, place = one / maximum(one, error), to
                for factor in (u, v, np.float32(1)):
                    summed = load(sums, place, PATCH) + weight * broadcast(factor, PATCH)
                    store(sums, place, summed)
                    place += np.uint64(window.shape[1] * width)
                upper, here, to = below, here + stride, to + np.uint64(width)
    for y in range(window.shape[1]):
        for axis in range(2):
            for x in range(width):
                window[axis, y, x] /= window[2, y, x]


@inlined
def _between(values: Array, at: np.uint64, share: np.float32) -> Any:
    """Interpolate a patch's row of values at a fraction of a pixel to the right."""
    left = load(values, at, PATCH)
    return multiply_add(broadcast(share, PATCH), load(values, at + np.uint64(1), PATCH) - left, left)
