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
    "light_change",
    "matched_places",
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


def matched_places(flow: DenseFlow) -> tuple[Array, Array]:
    """Find the same places in both pictures, as far as the flow between them is sure.

    Returns
    -------
    before, after : (n,) int64
        Cells of each picture, counted row by row: of every ``STEP``-th one before, and where it has gone.
    """
    height, width = flow.forward.shape[:2]
    xs, ys = (one.reshape(-1) for one in np.meshgrid(np.arange(0, width, STEP), np.arange(0, height, STEP)))
    sure = reliable_at(flow.forward, flow.backward, flow.side, flow.thresholds, xs, ys)
    ys, xs = ys[sure], xs[sure]
    moved = np.rint(flow.forward[ys, xs] / np.float32(flow.side)).astype(np.int64)
    there_y, there_x = ys + moved[:, 1], xs + moved[:, 0]
    inside = (there_x >= 0) & (there_x < width) & (there_y >= 0) & (there_y < height)
    return (ys * width + xs)[inside], (there_y * width + there_x)[inside]


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
    gains = _gains(before, after)
    change, left = unchanged(), _difference(before, after)
    if np.abs(np.log(gains)).max() >= LEAST_GAIN:
        change = _table([(gain, 0.0) for gain in gains])
        left = _difference(relit(before, change), after)
    if left >= LEAST_CHANGE:
        quantiles = zip(_quantiles(before), _quantiles(after), strict=True)
        offset_too = _table([_gain_and_offset(*channel) for channel in quantiles])
        if _difference(relit(before, offset_too), after) <= MOST_LEFT * left:
            return offset_too
    return change


@compiled
def _gains(before: Array, after: Array) -> Array:
    """By what each channel is multiplied, (c,) float64: the median ratio of values that are not cut off.

    The second time those are told by the first gain and the mean of both pictures: of values near the end of
    the range, a bound on one picture would leave those that noise has darkened there.
    """
    places, channels = before.shape
    gains, ratios, means, whole = np.ones(channels), np.empty(places), np.empty(places), np.empty(places)
    for channel in range(channels):
        for place in range(places):
            old, new = np.float64(before[place, channel]), np.float64(after[place, channel])
            ratios[place], means[place] = new / max(old, 1.0), np.sqrt(old * new)
        last = 0
        for _ in range(2):
            gain, count = np.sqrt(max(gains[channel], 1.0 / gains[channel])), 0
            for place in range(places):
                whole[count] = ratios[place]
                count += int(means[place] > DARKEST and means[place] * gain < BRIGHTEST - MARGIN)
            if count < LEAST_PLACES or count == last:  # too few, or the same ones once more
                break
            gains[channel], last = np.median(whole[:count]), count
    return gains


def _table(channels: list[tuple[float, float]]) -> Array:
    """What each value becomes by each channel's gain and offset, (c, 256) uint8."""
    levels = np.arange(256, dtype=np.float64)
    return np.stack(
        [np.clip(np.rint(gain * levels + offset), 0, 255).astype(np.uint8) for gain, offset in channels]
    )


@compiled
def _difference(before: Array, after: Array) -> float:
    """Mean over the channels of the median absolute difference, grey levels."""
    places, channels = before.shape
    total = 0.0
    for channel in range(channels):
        counts = np.zeros(256, np.int64)
        for place in range(places):
            counts[abs(np.int64(before[place, channel]) - np.int64(after[place, channel]))] += 1
        total += _ranked(counts, (places - 1) // 2) + _ranked(counts, places // 2)
    mean: float = total / (2 * channels)
    return mean


@compiled
def _ranked(counts: Array, rank: int) -> int:
    """Return the value of a rank, from 0 on, of values that are counted (256,) int64."""
    value, passed = 0, counts[0]
    while passed <= rank:
        value += 1
        passed += counts[value]
    return value


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
    """Return ``QUANTILES`` of each channel, (c, 19) float64."""
    ranks = np.rint(QUANTILES * (len(values) - 1)).astype(np.int64)
    found: Array = _of_ranks(values, ranks)
    return found


@compiled
def _of_ranks(values: Array, ranks: Array) -> Array:
    found = np.empty((values.shape[1], ranks.size))
    for channel in range(values.shape[1]):
        counts = np.zeros(256, np.int64)
        for place in range(len(values)):
            counts[values[place, channel]] += 1
        for place in range(ranks.size):
            found[channel, place] = _ranked(counts, ranks[place])
    return found


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
