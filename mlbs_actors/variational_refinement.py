"""Smooths a flow and fits it to the images: a variational method (Brox et al., ECCV 2004).

Each pixel's motion is to keep its grey level and the slopes of that, and to be its neighbours' motion, each
with a robust penalty √(e² + ε²). The penalties' weights are those of the flow as it is. What is left is a
linear system for its change, solved by some sweeps of red–black successive over-relaxation.

OpenCV's ``VariationalRefinement`` does the same, to a millionth of a pixel: some twenty maps, one after the
other. Here a row is done as soon as those are that it depends on, the solver's sweeps a row behind each
other, and what is in between stays in the processor's caches. Other than there, the target is read beyond a
part's sides, and warped anew for each step.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = ["refine_flow"]

#: Weights of the three penalties.
SMOOTHNESS, COLOUR, GRADIENT = np.float32(20.0), np.float32(5.0), np.float32(10.0)
#: Over-relaxation.
RELAXATION = np.float32(1.6)

_ZETA2, _EPSILON2 = np.float32(0.1**2), np.float32(0.001**2)
_HALF, _ONE = np.float32(0.5), np.float32(1)

# Kinds of rows, of which the last 16 are kept; each has a pixel more at both ends.
_ROWS = 16
_U, _V = 0, 1  # flow as it was
_MEAN, _DIFFERENCE = 2, 3  # of the source and the warped target
_X, _Y, _XT, _YT = 4, 5, 6, 7  # derivatives of these
_DU, _DV = 8, 9  # change of the flow, parted
_SPARE = 10  # for a row's own use: nothing is kept there
_KINDS = 11
# The system, which is made in spare rows and kept parted, what is read of it together side by side: of every
# row first every other pixel, then those in between. Half a sweep changes the ones or the others.
_A11, _A12, _A22, _B1, _B2 = 0, 1, 2, 3, 4  # the pixel's own part
_RIGHT, _BELOW = 5, 6  # what binds it to its neighbours
_PARTS = 7
_FIRST, _ABOVE = 7, 14  # spare rows of the system, and of what binds the pixels above to these


@compiled()
def refine_flow(
    source: Array, target: Array, left: int, top: int, flow: Array, margin: int, shades: int, sweeps: int
) -> None:
    """Refine the flow in a part of a frame, in place.

    Parameters
    ----------
    source : (h, w) uint8
        Grey levels.
    target : (h + 2 margin, w + 2 margin) float32
        Grey levels × ``shades``, continued past its sides.
    left, top : int
        Where the part begins in ``source``, px.
    flow : (2 or more, height, width) float32
        x and y of the motion from ``source`` to ``target``, px; 2 pixels a side at least.
    margin, shades : int
    sweeps : int
        Of the solver, at most 5.
    """
    height, width, last = flow.shape[1], flow.shape[2], flow.shape[1] - 1
    rows = np.zeros((_KINDS + _PARTS) * _ROWS * 2 * _half(width), np.float32)
    places = np.empty(width, np.int32)
    half_sweeps = 2 * sweeps
    for newest in range(height + 2 + half_sweeps):
        if newest < height:
            _read_flow(rows, newest, width, flow)
            _warp(rows, newest, width, source, target, left, top, margin, np.int32(shades), places)
        y = newest - 1
        if 0 <= y < height:
            _derive(rows, y, width, last, _MEAN, _X, _Y)
            _derive(rows, y, width, last, _DIFFERENCE, _XT, _YT)
        y = newest - 2
        if 0 <= y < height:
            _fit(rows, y, width, last)
            _bind(rows, y, width, last)
        for half_sweep in range(half_sweeps):
            y = newest - 3 - half_sweep
            if 0 <= y < height:
                _relax(rows, y, width, (y + half_sweep + 1) & 1)
        y = newest - 2 - half_sweeps
        if 0 <= y < height:
            _write_flow(rows, y, width, flow)


# A row's loops write one row each, and read no more than eight: what LLVM checks for overlap before it uses
# vector registers. Rows are places in one array, because slices of their own take longer than a short row.


@compiled(inline="always")
def _half(width: int) -> int:
    """Room for every other pixel of a row."""
    return (width + 3) // 2


@compiled(inline="always")
def _row(kind: int, y: int, width: int) -> np.uint64:
    """Where a row begins."""
    return np.uint64((kind * _ROWS + (y & (_ROWS - 1))) * 2 * _half(width))


@compiled(inline="always")
def _squared(value: np.float32) -> np.float32:
    return value * value


@compiled(inline="always")
def _continue(rows: Array, row: np.uint64, width: int) -> None:
    """Repeat a row's first and last pixel."""
    rows[row] = rows[row + np.uint64(1)]
    rows[row + np.uint64(width + 1)] = rows[row + np.uint64(width)]


@compiled()
def _read_flow(rows: Array, y: int, width: int, flow: Array) -> None:
    for part in range(2):
        known, change = _row(_U + part, y, width), _row(_DU + part, y, width)
        for x in range(width):
            rows[known + np.uint64(x + 1)] = flow[part, y, x]
        for x in range(2 * _half(width)):
            rows[change + np.uint64(x)] = 0
        _continue(rows, known, width)


@compiled()
def _write_flow(rows: Array, y: int, width: int, flow: Array) -> None:
    one, change, half = np.uint64(1), _row(_SPARE, 0, width), np.uint64(_half(width))
    for part in range(2):
        known, parted = _row(_U + part, y, width), _row(_DU + part, y, width)
        for k in range(_half(width)):
            at = np.uint64(k)
            rows[change + at + at] = rows[parted + at]
            rows[change + at + at + one] = rows[parted + half + at]
        for x in range(width):
            at = np.uint64(x + 1)
            flow[part, y, x] = rows[known + at] + rows[change + at]


@compiled()
def _warp(
    rows: Array, y: int, width: int, source: Array, target: Array, left: int, top: int, margin: int,
    shades: np.int32, places: Array,
) -> None:  # fmt: skip
    """Mean and difference of the source and of what the flow leads to in the target, grey levels."""
    one, zero = np.uint64(1), np.float32(0)
    u, v = _row(_U, y, width) + one, _row(_V, y, width) + one
    mean, difference = _row(_MEAN, y, width) + one, _row(_DIFFERENCE, y, width) + one
    across, down = _row(_SPARE, 0, width), _row(_SPARE, 1, width)
    right, bottom = np.float32(target.shape[1] - 2), np.float32(target.shape[0] - 2)
    first_x, there_y, stride = np.int32(left + margin), np.float32(y + top + margin), target.shape[1]
    for x in range(width):
        at = np.uint64(x)
        there = min(max(np.float32(np.int32(x) + first_x) + rows[u + at], zero), right)
        places[at] = np.int32(there)
        rows[across + at] = there - np.float32(np.int32(there))
    for x in range(width):
        at = np.uint64(x)
        there = min(max(there_y + rows[v + at], zero), bottom)
        places[at] += np.int32(np.int32(there) * np.int32(stride))
        rows[down + at] = there - np.float32(np.int32(there))
    shown = target.reshape(-1)
    for x in range(width):  # the only one that reads here and there
        at = np.uint64(x)
        place, share = np.uint64(np.uint32(places[at])), rows[across + at]
        upper = shown[place] + share * (shown[place + one] - shown[place])
        place += np.uint64(stride)
        lower = shown[place] + share * (shown[place + one] - shown[place])
        rows[difference + at] = upper + rows[down + at] * (lower - upper)
    gray, first = source.reshape(-1), np.uint64((y + top) * source.shape[1] + left)
    own, unit = _row(_SPARE, 2, width), np.float32(1.0 / shades)
    for x in range(width):
        at = np.uint64(x)
        rows[own + at] = np.float32(np.int32(gray[first + at]) * shades)
    for x in range(width):
        at = np.uint64(x)
        rows[mean + at] = _HALF * unit * (rows[own + at] + rows[difference + at])
    for x in range(width):
        at = np.uint64(x)
        rows[difference + at] = unit * (rows[difference + at] - rows[own + at])
    _continue(rows, mean - one, width)
    _continue(rows, difference - one, width)


@compiled()
def _subtract(rows: Array, later: np.uint64, earlier: np.uint64, difference: np.uint64, width: int) -> None:
    for x in range(1, width + 1):
        at = np.uint64(x)
        rows[difference + at] = rows[later + at] - rows[earlier + at]


@compiled()
def _derive(rows: Array, y: int, width: int, last: int, of: int, along_x: int, along_y: int) -> None:
    """Differences of the pixels on both sides, once for the frame's mean and once for its difference."""
    one, here = np.uint64(1), _row(of, y, width)
    above, below = _row(of, max(y - 1, 0), width), _row(of, min(y + 1, last), width)
    x_slope, y_slope = _row(along_x, y, width), _row(along_y, y, width)
    _subtract(rows, here + one, here - one, x_slope, width)
    _subtract(rows, below, above, y_slope, width)
    _continue(rows, x_slope, width)
    _continue(rows, y_slope, width)


@compiled(inline="always")
def _made(part: int, width: int) -> np.uint64:
    """Where a part of a row's system is made."""
    return _row(_SPARE, _FIRST + part, width)


@compiled(inline="always")
def _kept(part: int, y: int, width: int, side: int) -> np.uint64:
    """Where it is kept of every other pixel, parted."""
    return _row(_KINDS, 0, width) + np.uint64((((y & (_ROWS - 1)) * 2 + side) * _PARTS + part) * _half(width))


@compiled()
def _fit(rows: Array, y: int, width: int, last: int) -> None:
    """The system's part for grey levels and slopes that are to stay."""
    one, above, below = np.uint64(1), max(y - 1, 0), min(y + 1, last)
    along_x, along_y, along_t = _row(_X, y, width), _row(_Y, y, width), _row(_DIFFERENCE, y, width)
    x_above, x_below = _row(_X, above, width), _row(_X, below, width)
    y_above, y_below = _row(_Y, above, width), _row(_Y, below, width)
    along_xt, along_yt = _row(_XT, y, width), _row(_YT, y, width)
    along_xx, along_xy, along_yy = _row(_SPARE, 0, width), _row(_SPARE, 1, width), _row(_SPARE, 2, width)
    colour, weight = _row(_SPARE, 3, width), _row(_SPARE, 4, width)
    x_weight, y_weight = _row(_SPARE, 5, width), _row(_SPARE, 6, width)
    a11, a12, a22 = _made(_A11, width), _made(_A12, width), _made(_A22, width)
    b1, b2 = _made(_B1, width), _made(_B2, width)
    _subtract(rows, along_x + one, along_x - one, along_xx, width)
    _subtract(rows, x_below, x_above, along_xy, width)
    _subtract(rows, y_below, y_above, along_yy, width)
    for x in range(1, width + 1):
        at = np.uint64(x)
        norm = _squared(rows[along_x + at]) + _squared(rows[along_y + at]) + _ZETA2
        rows[colour + at] = _HALF * COLOUR / (np.sqrt(_squared(rows[along_t + at]) / norm + _EPSILON2) * norm)
    for slope, norm_inverse in ((along_xx, x_weight), (along_yy, y_weight)):
        for x in range(1, width + 1):
            at = np.uint64(x)
            norm = _squared(rows[slope + at]) + _squared(rows[along_xy + at]) + _ZETA2
            rows[norm_inverse + at] = _ONE / norm
    for x in range(1, width + 1):
        at = np.uint64(x)
        error = (
            _squared(rows[along_xt + at]) * rows[x_weight + at]
            + _squared(rows[along_yt + at]) * rows[y_weight + at]
        )
        rows[weight + at] = _HALF * GRADIENT / np.sqrt(error + _EPSILON2)
    for x in range(1, width + 1):
        at = np.uint64(x)
        rows[x_weight + at] *= rows[weight + at]
        rows[y_weight + at] *= rows[weight + at]
    for along, by_x, by_y, a in ((along_x, along_xx, along_xy, a11), (along_y, along_xy, along_yy, a22)):
        for x in range(1, width + 1):
            at = np.uint64(x)
            slopes = rows[x_weight + at] * _squared(rows[by_x + at])
            slopes += rows[y_weight + at] * _squared(rows[by_y + at])
            rows[a + at] = rows[colour + at] * _squared(rows[along + at]) + slopes + _ZETA2
    for x in range(1, width + 1):
        at = np.uint64(x)
        slopes = rows[x_weight + at] * rows[along_xx + at] + rows[y_weight + at] * rows[along_yy + at]
        own = rows[colour + at] * rows[along_x + at] * rows[along_y + at]
        rows[a12 + at] = own + slopes * rows[along_xy + at]
    for x in range(1, width + 1):  # from here on the weights stand for what they weigh
        at = np.uint64(x)
        rows[colour + at] *= rows[along_t + at]
    for x in range(1, width + 1):
        at = np.uint64(x)
        rows[x_weight + at] *= rows[along_xt + at]
        rows[y_weight + at] *= rows[along_yt + at]
    for along, by_x, by_y, b in ((along_x, along_xx, along_xy, b1), (along_y, along_xy, along_yy, b2)):
        for x in range(1, width + 1):
            at = np.uint64(x)
            slopes = rows[x_weight + at] * rows[by_x + at] + rows[y_weight + at] * rows[by_y + at]
            rows[b + at] = -(rows[colour + at] * rows[along + at] + slopes)


@compiled()
def _bind(rows: Array, y: int, width: int, last: int) -> None:
    """The system's part for smoothness; the diagonal is turned over, for it is divided by only."""
    one, following = np.uint64(1), min(y + 1, last)
    right, below, above = _made(_RIGHT, width), _made(_BELOW, width), _row(_SPARE, _ABOVE, width)
    for x in range(1, width + 1):
        rows[above + np.uint64(x)] = rows[below + np.uint64(x)]
    u, v = _row(_U, y, width), _row(_V, y, width)
    u_below, v_below = _row(_U, following, width), _row(_V, following, width)
    for x in range(1, width + 1):
        at = np.uint64(x)
        across = _squared(rows[u + at + one] - rows[u + at]) + _squared(rows[v + at + one] - rows[v + at])
        down = _squared(rows[u_below + at] - rows[u + at]) + _squared(rows[v_below + at] - rows[v + at])
        rows[right + at] = _HALF * SMOOTHNESS / np.sqrt(across + down + _EPSILON2)
    share = np.float32(y < last)
    for x in range(1, width + 1):
        at = np.uint64(x)
        rows[below + at] = share * rows[right + at]
    rows[right + np.uint64(width)] = 0
    bonds = _row(_SPARE, 0, width)
    for x in range(1, width + 1):
        at = np.uint64(x)
        beside = rows[right + at] + rows[right + at - one]
        rows[bonds + at] = beside + rows[below + at] + rows[above + at]
    for flow, side, diagonal in ((_U, _B1, _A11), (_V, _B2, _A22)):
        here, b, a = _row(flow, y, width), _made(side, width), _made(diagonal, width)
        over, under = _row(flow, y - 1, width), _row(flow, following, width)
        for x in range(1, width + 1):
            at = np.uint64(x)
            after, before = rows[here + at + one] - rows[here + at], rows[here + at] - rows[here + at - one]
            beside = rows[right + at] * after - rows[right + at - one] * before
            after, before = rows[under + at] - rows[here + at], rows[here + at] - rows[over + at]
            rows[b + at] += beside + rows[below + at] * after - rows[above + at] * before
        for x in range(1, width + 1):
            at = np.uint64(x)
            rows[a + at] = RELAXATION / (rows[a + at] + rows[bonds + at])
    # Last, parted: half a sweep reads one half of it and does half of the work.
    made, even, odd = _made(0, width), _kept(0, y, width, 0), _kept(0, y, width, 1)
    for k in range(_PARTS * _half(width)):
        at = np.uint64(k)
        rows[even + at], rows[odd + at] = rows[made + at + at], rows[made + at + at + one]


@compiled()
def _relax(rows: Array, y: int, width: int, side: int) -> None:
    """Half a sweep: every other pixel of a row, from its neighbours, which are of the other half."""
    one, pull, half = np.uint64(1), _row(_SPARE, 0, width), np.uint64(_half(width))
    # A row has a pixel more at both ends, and the first one is of the first half.
    first, count = np.uint64(1 - side), (width + side) // 2
    here, beside = first + np.uint64(side) * half, np.uint64(1 - side) * half
    right, right_before = _kept(_RIGHT, y, width, side) + first, _kept(_RIGHT, y, width, 1 - side)
    below, above = _kept(_BELOW, y, width, side) + first, _kept(_BELOW, y - 1, width, side) + first
    mixed = _kept(_A12, y, width, side) + first
    for of, another, constant, diagonal in ((_DU, _DV, _B1, _A11), (_DV, _DU, _B2, _A22)):
        own, other = _row(of, y, width) + here, _row(another, y, width) + here
        b, a = _kept(constant, y, width, side) + first, _kept(diagonal, y, width, side) + first
        before = _row(of, y, width) + beside
        over, under = _row(of, y - 1, width) + here, _row(of, y + 1, width) + here
        for k in range(count):
            at = np.uint64(k)
            across = rows[right + at] * rows[before + at + one] + rows[right_before + at] * rows[before + at]
            rows[pull + at] = (
                across + rows[below + at] * rows[under + at] + rows[above + at] * rows[over + at]
            )
        for k in range(count):
            at = np.uint64(k)
            drawn = rows[pull + at] + rows[b + at] - rows[mixed + at] * rows[other + at]
            rows[own + at] += rows[a + at] * drawn - RELAXATION * rows[own + at]
