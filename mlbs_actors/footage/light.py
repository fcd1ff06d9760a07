"""How exposure and white balance have changed between two pictures, and what was seen before in new light.

Each channel is taken to have changed by a gain and an offset, cut off at 0 and 255: automatic exposure and
white balance, clouds, flicker. They are fitted to the same places of the scene in both pictures, as the flow
finds them. A gain alone is the median of the ratios, which neither noise, nor a moving object, nor motion
blur bends, so that it tells a change of 2 % a frame. Where a gain and an offset leave much less, they are
fitted to quantiles, which do not flatten the gain as a regression on noisy values does, but move with motion
blur.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.flow.consistency import DenseFlow, reliable_at
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "colour_samples",
    "light_change",
    "matched_colours",
    "relit",
    "saturates",
    "strength",
    "unchanged",
]

#: From one sampled cell to the next, cells.
STEP = 6
#: The quantiles of a channel that are compared.
QUANTILES = np.linspace(0.05, 0.95, 19)
#: Levels that may be cut off say nothing of the gain.
DARKEST, BRIGHTEST = 3, 252
#: How far from there noise brings no value, grey levels.
MARGIN = 12
#: Least number of quantiles and of places for a fit, and least spread for a gain, grey levels.
LEAST_QUANTILES, LEAST_PLACES, LEAST_SPREAD = 5, 64, 4.0
#: A smaller gain of every channel, as a logarithm, is none.
LEAST_GAIN = 0.015
#: A smaller difference between matched values is noise, and no offset, grey levels.
LEAST_CHANGE = 3.0
#: A gain and an offset must leave at most this share of what differs without an offset.
MOST_LEFT = 0.6
#: Share of the values that a new light cuts off above which what was seen before is lost for the most part.
MOST_CUT_OFF = 0.05


def colour_samples(frame: Array, side: int) -> Array:
    """Return mean colours of every ``STEP``-th cell of a frame.

    Parameters
    ----------
    frame : (H, W, 3) uint8
    side : int
        Of a cell, px.

    Returns
    -------
    (rows, columns, 3) uint8
    """
    height, width = frame.shape[:2]
    rows, columns = np.arange(0, height // side, STEP), np.arange(0, width // side, STEP)
    xs, ys = np.meshgrid(columns, rows)
    return _cell_colours(frame, side, xs.reshape(-1), ys.reshape(-1)).reshape(rows.size, columns.size, 3)


def matched_colours(before: Array, frame: Array, flow: DenseFlow) -> tuple[Array, Array]:
    """Colours of the same places in both pictures, as far as the flow is sure of them.

    Parameters
    ----------
    before : (rows, columns, 3) uint8
        :func:`colour_samples` of the picture before.
    frame : (H, W, 3) uint8
    flow : DenseFlow
        Between the two.

    Returns
    -------
    two (n, 3) uint8
    """
    ys, xs = (STEP * one.reshape(-1) for one in np.indices(before.shape[:2]))
    sure = np.flatnonzero(reliable_at(flow.forward, flow.backward, flow.side, flow.thresholds, xs, ys))
    xs, ys = xs[sure], ys[sure]
    moved = np.rint(flow.forward[ys, xs] / np.float32(flow.side)).astype(np.int64)
    height, width = flow.forward.shape[:2]
    there_x, there_y = xs + moved[:, 0], ys + moved[:, 1]
    inside = (there_x >= 0) & (there_x < width - 1) & (there_y >= 0) & (there_y < height - 1)
    after = _cell_colours(frame, flow.side, there_x[inside], there_y[inside])
    return before.reshape(-1, 3)[sure[inside]], after


def light_change(before: Array, after: Array) -> Array:
    """Fit how the light has changed.

    Parameters
    ----------
    before, after : (n, c) uint8
        Values of the same places in both pictures.

    Returns
    -------
    (c, 256) uint8
        What each value of each channel has become; (0, 256) if the light is the same.
    """
    if len(before) < LEAST_PLACES:
        return unchanged()
    gains = [_gain(old, new) for old, new in zip(before.T, after.T, strict=True)]
    change, left = unchanged(), _difference(before, after)
    if np.abs(np.log(gains)).max() >= LEAST_GAIN:
        change = _table([(gain, 0.0) for gain in gains])
        left = _difference(relit(before, change), after)
    if left >= LEAST_CHANGE:
        old, new = _quantiles(before).T, _quantiles(after).T
        offset_too = _table([_gain_and_offset(*channel) for channel in zip(old, new, strict=True)])
        if _difference(relit(before, offset_too), after) <= MOST_LEFT * left:
            return offset_too
    return change


def _gain(old: Array, new: Array) -> float:
    """By what a channel is multiplied: the median of the ratios of values that are not cut off.

    The second time those are told by the first gain and the mean of both pictures: of values near the end of
    the range, a bound on one picture would leave those that noise has darkened there.
    """
    ratios = new / np.maximum(old, 1).astype(np.float64)
    mean, gain = np.sqrt(old * new.astype(np.float64)), 1.0
    for _ in range(2):
        whole = (mean > DARKEST) & (mean * np.sqrt(max(gain, 1.0 / gain)) < BRIGHTEST - MARGIN)
        if whole.sum() < LEAST_PLACES:
            break
        gain = float(np.median(ratios[whole]))
    return gain


def _table(channels: list[tuple[float, float]]) -> Array:
    """What each value becomes by each channel's gain and offset, (c, 256) uint8."""
    levels = np.arange(256, dtype=np.float64)
    return np.stack(
        [np.clip(np.rint(gain * levels + offset), 0, 255).astype(np.uint8) for gain, offset in channels]
    )


def _difference(before: Array, after: Array) -> float:
    """Mean over the channels of the median absolute difference, grey levels."""
    differences = np.abs(before.astype(np.int16) - after)
    return float(np.median(differences, axis=0).mean())


def unchanged() -> Array:
    """The table of the same light, (0, 256) uint8."""
    return np.zeros((0, 256), np.uint8)


def strength(change: Array) -> float:
    """By how much values between 32 and 224 have changed at most, grey levels."""
    if not change.size:
        return 0.0
    return float(np.abs(change[:, 32:225].astype(int) - np.arange(32, 225)).max())


def saturates(values: Array, change: Array) -> bool:
    """Whether a change of light cuts off many of the values (n, c) uint8 that were seen before."""
    if not change.size or not len(values):
        return False
    seen = relit(values, change)
    cut_off = ((seen == 0) | (seen == 255)) & (values > 0) & (values < 255)
    return bool(cut_off.mean() > MOST_CUT_OFF)


def relit(values: Array, change: Array) -> Array:
    """Return what has been seen before, in new light.

    Parameters
    ----------
    values : (..., c) uint8
    change : (c, 256) uint8
        :func:`light_change`; of no channel if the light is the same.

    Returns
    -------
    (..., c) uint8
        ``values`` themselves if the light is the same.
    """
    if not change.size:
        return values
    seen = np.empty_like(values)
    for channel, table in enumerate(change):
        seen[..., channel] = table[values[..., channel]]
    return seen


def _quantiles(values: Array) -> Array:
    places = np.rint(QUANTILES * (len(values) - 1)).astype(np.intp)
    return np.sort(values, axis=0)[places].astype(np.float64)


def _gain_and_offset(old: Array, new: Array) -> tuple[float, float]:
    """Gain and offset between quantiles of a channel."""
    whole = (old > DARKEST) & (old < BRIGHTEST) & (new > DARKEST) & (new < BRIGHTEST)
    if whole.sum() < LEAST_QUANTILES:
        return 1.0, float(np.median(new - old))
    old, new = old[whole], new[whole]
    if min(old.std(), new.std()) < LEAST_SPREAD:
        return 1.0, float(np.median(new - old))
    gain = float(new.std() / old.std())
    return gain, float(new.mean() - gain * old.mean())


@compiled
def _cell_colours(frame: Array, side: int, xs: Array, ys: Array) -> Array:
    """Mean colours of cells, (n, 3) uint8."""
    colours, cells = np.empty((xs.size, 3), np.uint8), side * side
    for place in range(xs.size):
        for channel in range(3):
            total = cells // 2
            for row in range(ys[place] * side, (ys[place] + 1) * side):
                for column in range(xs[place] * side, (xs[place] + 1) * side):
                    total += int(frame[row, column, channel])
            colours[place, channel] = total // cells
    return colours
