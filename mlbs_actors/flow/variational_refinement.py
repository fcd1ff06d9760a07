"""Variational refinement: smooths a flow and fits it to the images (Brox et al., ECCV 2004).

Each pixel's motion should keep its grey level and the gradient of that, and agree with its neighbours'
motion, each with a robust penalty √(e² + ε²). The penalties' weights are those of the current flow. That
leaves a linear system for its change, solved by some sweeps of red–black successive over-relaxation.

OpenCV's ``VariationalRefinement`` does the same, to a millionth of a pixel, in some twenty passes over whole
maps. Here each row is processed as soon as the rows that it depends on are, with the solver's sweeps one row
behind each other, so intermediate values stay in the processor's caches. Unlike there, the target is read
beyond a part's sides, and warped anew for each step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.kernels.simd import LANES, broadcast, load, square_root, store
from mlbs_actors.messages import Array

__all__ = ["refine_flow"]

#: Weights of the three penalties.
SMOOTHNESS, COLOUR, GRADIENT = np.float32(20.0), np.float32(5.0), np.float32(10.0)
#: Over-relaxation.
RELAXATION = np.float32(1.6)

_ZETA2, _EPSILON2 = np.float32(0.1**2), np.float32(0.001**2)
_HALF, _ONE = np.float32(0.5), np.float32(1)

# Kinds of rows; the last 16 of each are kept, with one more pixel at both ends.
_ROWS = 16
_U, _V = 0, 1  # the flow so far
_MEAN, _DIFFERENCE = 2, 3  # of the source and the warped target
_X, _Y, _XT, _YT = 4, 5, 6, 7  # derivatives of these
_DU, _DV = 8, 9  # change of the flow, parted
_SPARE = 10  # scratch space of a row; nothing is kept there
_KINDS = 11
# The system is assembled in scratch rows and stored with the even pixels of a row first, then the odd ones:
# half a sweep changes one or the other.
_A11, _A12, _A22, _B1, _B2 = 0, 1, 2, 3, 4  # the pixel's own part
_RIGHT, _BELOW = 5, 6  # couples it to its neighbours
_PARTS = 7
_FIRST, _ABOVE = 7, 14  # scratch rows of the system, and of the coupling of the row above


@compiled
def refine_flow(
    source: Array, target: Array, corner: tuple[int, int], flow: Array, margin: int, sweeps: int
) -> None:
    """Refine the flow in a part of a frame, in place.

    Parameters
    ----------
    source : (h, w) uint8
        Grey levels.
    target : (h + 2 margin, w + 2 margin) float32
        Grey levels, continued past its sides.
    corner : (int, int)
        (x, y) in ``source`` where the part begins, px.
    flow : (2 or more, height, width) float32
        x and y of the motion from ``source`` to ``target``, px; 2 pixels a side at least.
    margin : int
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
            _warp(rows, newest, width, source, target, corner, margin, places)
        y = newest - 1
        if 0 <= y < height:
            _derive(rows, y, width, last, _MEAN, _X, _Y)
            _derive(rows, y, width, last, _DIFFERENCE, _XT, _YT)
        y = newest - 2
        if 0 <= y < height:
            _bind(rows, y, width, last)
            _fit(rows, y, width, last)
            _part(rows, y, width)
        for half_sweep in range(half_sweeps):
            y = newest - 3 - half_sweep
            if 0 <= y < height:
                _relax(rows, y, width, (y + half_sweep + 1) & 1)
        y = newest - 2 - half_sweeps
        if 0 <= y < height:
            _write_flow(rows, y, width, flow)


# Rows are offsets into one array, because slicing takes longer than a short row. Values computed past a row's
# end are ordinary numbers that pixels read with weight 0 only.


@inlined
def _half(width: int) -> int:
    """Return the room for every other pixel of a row, padded for whole registers."""
    return width // (2 * LANES) * LANES + LANES + 2


@inlined
def _row(kind: int, y: int, width: int) -> np.uint64:
    """Where a row begins."""
    return np.uint64((kind * _ROWS + (y & (_ROWS - 1))) * 2 * _half(width))


@inlined
def _lanes(rows: Array, kind: int, y: int, width: int, x: int) -> Any:
    """Load some pixels of a row from x on, counted from the one before its first."""
    return load(rows, _row(kind, y, width) + np.uint64(x), LANES)


@inlined
def _alike(value: np.float32) -> Any:
    return broadcast(value, LANES)


@inlined
def _continue(rows: Array, row: np.uint64, width: int) -> None:
    """Repeat a row's first and last pixel."""
    rows[row] = rows[row + np.uint64(1)]
    rows[row + np.uint64(width + 1)] = rows[row + np.uint64(width)]


@compiled
def _read_flow(rows: Array, y: int, width: int, flow: Array) -> None:
    for part in range(2):
        known, change = _row(_U + part, y, width), _row(_DU + part, y, width)
        for x in range(width):
            rows[known + np.uint64(x + 1)] = flow[part, y, x]
        for x in range(2 * _half(width)):
            rows[change + np.uint64(x)] = 0
        _continue(rows, known, width)


@compiled
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


@compiled
def _warp(
    rows: Array, y: int, width: int, source: Array, target: Array, corner: tuple[int, int], margin: int,
    places: Array,
) -> None:  # fmt: skip
    """Compute mean and difference of the source and the warped target, grey levels."""
    left, top = corner
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
    for x in range(width):  # a gather: not vectorised
        at = np.uint64(x)
        place, share = np.uint64(np.uint32(places[at])), rows[across + at]
        upper = shown[place] + share * (shown[place + one] - shown[place])
        place += np.uint64(stride)
        lower = shown[place] + share * (shown[place + one] - shown[place])
        rows[difference + at] = upper + rows[down + at] * (lower - upper)
    gray, first = source.reshape(-1), np.uint64((y + top) * source.shape[1] + left)
    own = _row(_SPARE, 2, width)
    for x in range(width):
        at = np.uint64(x)
        rows[own + at] = np.float32(gray[first + at])
    for x in range(width):
        at = np.uint64(x)
        rows[mean + at] = _HALF * (rows[own + at] + rows[difference + at])
    for x in range(width):
        at = np.uint64(x)
        rows[difference + at] -= rows[own + at]
    _continue(rows, mean - one, width)
    _continue(rows, difference - one, width)


@compiled
def _derive(rows: Array, y: int, width: int, last: int, of: int, along_x: int, along_y: int) -> None:
    """Difference the pixels on both sides, for the mean of both frames and for their difference."""
    above, below = max(y - 1, 0), min(y + 1, last)
    x_slope, y_slope = _row(along_x, y, width), _row(along_y, y, width)
    for x in range(1, width + 1, LANES):
        across = _lanes(rows, of, y, width, x + 1) - _lanes(rows, of, y, width, x - 1)
        store(rows, x_slope + np.uint64(x), across)
        down = _lanes(rows, of, below, width, x) - _lanes(rows, of, above, width, x)
        store(rows, y_slope + np.uint64(x), down)
    _continue(rows, x_slope, width)
    _continue(rows, y_slope, width)


@inlined
def _made(part: int, width: int) -> np.uint64:
    """Return where a part of a row's system is assembled."""
    return _row(_SPARE, _FIRST + part, width)


@inlined
def _kept(part: int, y: int, width: int, side: int) -> np.uint64:
    """Return where that part is stored for every other pixel."""
    return _row(_KINDS, 0, width) + np.uint64((((y & (_ROWS - 1)) * 2 + side) * _PARTS + part) * _half(width))


@compiled
def _bind(rows: Array, y: int, width: int, last: int) -> None:
    """Assemble the smoothness part of the system: the coupling of a pixel to its neighbours."""
    following = min(y + 1, last)
    right, below, above = _made(_RIGHT, width), _made(_BELOW, width), _row(_SPARE, _ABOVE, width)
    strength, share = _alike(_HALF * SMOOTHNESS), _alike(np.float32(y < last))
    for x in range(1, width + 1, LANES):
        at = np.uint64(x)
        store(rows, above + at, load(rows, below + at, LANES))
        u, v = _lanes(rows, _U, y, width, x), _lanes(rows, _V, y, width, x)
        across_u, across_v = _lanes(rows, _U, y, width, x + 1) - u, _lanes(rows, _V, y, width, x + 1) - v
        down_u, down_v = _lanes(rows, _U, following, width, x) - u, _lanes(rows, _V, following, width, x) - v
        across, down = across_u * across_u + across_v * across_v, down_u * down_u + down_v * down_v
        bond = strength / square_root(across + down + _alike(_EPSILON2))
        store(rows, right + at, bond)
        store(rows, below + at, share * bond)
    rows[right + np.uint64(width)] = 0


@compiled
def _fit(rows: Array, y: int, width: int, last: int) -> None:
    """Assemble the data terms of grey levels and gradients, then the pixel's diagonal, stored inverted as it
    is only divided by."""
    over, under = max(y - 1, 0), min(y + 1, last)
    zeta2, epsilon2 = _alike(_ZETA2), _alike(_EPSILON2)
    for x in range(1, width + 1, LANES):
        along_x, along_y = _lanes(rows, _X, y, width, x), _lanes(rows, _Y, y, width, x)
        along_xt, along_yt = _lanes(rows, _XT, y, width, x), _lanes(rows, _YT, y, width, x)
        along_t = _lanes(rows, _DIFFERENCE, y, width, x)
        along_xx = _lanes(rows, _X, y, width, x + 1) - _lanes(rows, _X, y, width, x - 1)
        along_xy = _lanes(rows, _X, under, width, x) - _lanes(rows, _X, over, width, x)
        along_yy = _lanes(rows, _Y, under, width, x) - _lanes(rows, _Y, over, width, x)
        xx, xy, yy = along_xx * along_xx, along_xy * along_xy, along_yy * along_yy
        norm = along_x * along_x + along_y * along_y + zeta2
        colour = _alike(_HALF * COLOUR) / (square_root(along_t * along_t / norm + epsilon2) * norm)
        x_weight, y_weight = _alike(_ONE) / (xx + xy + zeta2), _alike(_ONE) / (yy + xy + zeta2)
        error = along_xt * along_xt * x_weight + along_yt * along_yt * y_weight
        weight = _alike(_HALF * GRADIENT) / square_root(error + epsilon2)
        x_weight, y_weight = x_weight * weight, y_weight * weight

        at, bound = np.uint64(x), _FIRST + _RIGHT
        right, left = _lanes(rows, _SPARE, bound, width, x), _lanes(rows, _SPARE, bound, width, x - 1)
        below, above = _lanes(rows, _SPARE, _FIRST + _BELOW, width, x), _lanes(rows, _SPARE, _ABOVE, width, x)
        bonds, coupling = (right, left, below, above), right + left + below + above
        a11 = colour * (along_x * along_x) + (x_weight * xx + y_weight * xy) + zeta2
        a22 = colour * (along_y * along_y) + (x_weight * xy + y_weight * yy) + zeta2
        a12 = colour * along_x * along_y + (x_weight * along_xx + y_weight * along_yy) * along_xy
        store(rows, _made(_A11, width) + at, _alike(RELAXATION) / (a11 + coupling))
        store(rows, _made(_A22, width) + at, _alike(RELAXATION) / (a22 + coupling))
        store(rows, _made(_A12, width) + at, a12)
        # From here on the weights hold the weighted terms.
        colour, x_weight, y_weight = colour * along_t, x_weight * along_xt, y_weight * along_yt
        pull = _drawn(rows, _U, y, width, under, x, bonds)
        push = colour * along_x + (x_weight * along_xx + y_weight * along_xy)
        store(rows, _made(_B1, width) + at, pull - push)
        pull = _drawn(rows, _V, y, width, under, x, bonds)
        push = colour * along_y + (x_weight * along_xy + y_weight * along_yy)
        store(rows, _made(_B2, width) + at, pull - push)


@inlined
def _drawn(
    rows: Array, flow: int, y: int, width: int, under: int, x: int, bonds: tuple[Any, Any, Any, Any]
) -> Any:
    """Sum the pull on a component of the flow, weighted by the bonds to the right, left, below and above."""
    right, left, below, above = bonds
    here = _lanes(rows, flow, y, width, x)
    after, before = _lanes(rows, flow, y, width, x + 1) - here, here - _lanes(rows, flow, y, width, x - 1)
    beside = right * after - left * before
    after, before = _lanes(rows, flow, under, width, x) - here, here - _lanes(rows, flow, y - 1, width, x)
    return beside + below * after - above * before


@compiled
def _part(rows: Array, y: int, width: int) -> None:
    """Store a row's system with even and odd pixels apart: half a sweep reads only one half."""
    made, even, odd = _made(0, width), _kept(0, y, width, 0), _kept(0, y, width, 1)
    for k in range(_PARTS * _half(width)):
        at = np.uint64(k)
        rows[even + at], rows[odd + at] = rows[made + at + at], rows[made + at + at + np.uint64(1)]


@compiled
def _relax(rows: Array, y: int, width: int, side: int) -> None:
    """Do half a sweep: relax every other pixel of a row from its neighbours, which are in the other half."""
    half = _half(width)
    # A row has one more pixel at both ends, and the first one is in the first half.
    first, count = 1 - side, (width + side) // 2
    before = _kept(_RIGHT, y, width, 1 - side)
    right, below = _kept(_RIGHT, y, width, side), _kept(_BELOW, y, width, side)
    above, mixed = _kept(_BELOW, y - 1, width, side), _kept(_A12, y, width, side)
    for k in range(0, count, LANES):
        at, own, beside = np.uint64(first + k), first + side * half + k, (1 - side) * half + k
        after, earlier = load(rows, right + at, LANES), load(rows, before + np.uint64(k), LANES)
        lower, upper = load(rows, below + at, LANES), load(rows, above + at, LANES)
        change_u, change_v = _lanes(rows, _DU, y, width, own), _lanes(rows, _DV, y, width, own)
        mix = load(rows, mixed + at, LANES)

        pull = after * _lanes(rows, _DU, y, width, beside + 1) + earlier * _lanes(rows, _DU, y, width, beside)
        pull = pull + lower * _lanes(rows, _DU, y + 1, width, own)
        pull = pull + upper * _lanes(rows, _DU, y - 1, width, own)
        drawn = pull + load(rows, _kept(_B1, y, width, side) + at, LANES) - mix * change_v
        share = load(rows, _kept(_A11, y, width, side) + at, LANES)
        change_u = change_u + (share * drawn - _alike(RELAXATION) * change_u)
        store(rows, _row(_DU, y, width) + np.uint64(own), change_u)

        pull = after * _lanes(rows, _DV, y, width, beside + 1) + earlier * _lanes(rows, _DV, y, width, beside)
        pull = pull + lower * _lanes(rows, _DV, y + 1, width, own)
        pull = pull + upper * _lanes(rows, _DV, y - 1, width, own)
        drawn = pull + load(rows, _kept(_B2, y, width, side) + at, LANES) - mix * change_u
        share = load(rows, _kept(_A22, y, width, side) + at, LANES)
        change_v = change_v + (share * drawn - _alike(RELAXATION) * change_v)
        store(rows, _row(_DV, y, width) + np.uint64(own), change_v)
