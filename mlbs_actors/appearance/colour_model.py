"""A layer's appearance model: the last N colours of every pixel (§6).

Pixels are those of the images that the model is given: in the engine, cells (:mod:`mlbs_actors.cells`).

A *stack* holds a pixel's samples; :mod:`mlbs_actors.appearance.colour_density` turns it into a density. Each
frame it moves with the layer (:func:`warp_model`) and learns the pixels that the layer won (:func:`update`).

**Spread.** A stack keeps the running median of the mean absolute difference between a sample and the one
before it, the kernel's bandwidth. A true median of N differences a pixel and frame costs more than the
whole evaluation; the running one moves by at most half a grey level a frame towards the new difference.

**Sub-pixel position.** The stack at pixel i describes the point i + r(i) (see
:mod:`mlbs_actors.appearance.warp`), so the frame is read at i + r(i) too, bilinearly, to learn and to
evaluate: a sample is interpolated once in its life and only moved afterwards.

Differs from the paper: it does not say how stacks are moved by fractions of a pixel, nor which sample is
replaced: here each pixel forgets its own oldest, whenever it was learnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.appearance.warp import nearest_sources
from mlbs_actors.kernels.image_rows import padded_planes, read_row, row_room
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = [
    "SPREAD_STEP",
    "AppearanceModel",
    "empty_model",
    "learn_colours",
    "median_colours",
    "moved_stacks",
    "relight",
    "update",
    "warp_model",
]

#: Unit of ``AppearanceModel.spread``, grey levels.
SPREAD_STEP = 1.0 / 8.0
#: Words of a stack of 16 samples: a loop of known length takes half of the time.
_USUAL_WORDS = 6
#: Step of the running median in a frame, in units of ``SPREAD_STEP``.
_SPREAD_RATE = 4


@dataclass(frozen=True, slots=True)
class AppearanceModel:
    """The colours of one layer on its region. The arrays are the state: :func:`update` writes into them.

    Attributes
    ----------
    region : Region
        Where the stacks are in the frame.
    samples : (h, w, 3, N) uint8
        Colours, BGR; the first ``count`` are valid.
    count : (h, w) uint8
        Number of samples, 0 (unknown) … N.
    newest : (h, w) uint8
        Index of the newest sample.
    spread : (h, w) uint8
        Running median of the successive differences, in units of ``SPREAD_STEP`` grey levels.
    residual : (h, w, 2) float32
        Offset (x, y) of the described point from the pixel's centre, px.
    """

    region: Region
    samples: Array
    count: Array
    newest: Array
    spread: Array
    residual: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """Samples, count, newest, spread and residual, for compiled functions."""
        return self.samples, self.count, self.newest, self.spread, self.residual


def empty_model(region: Region, sample_count: int = 20) -> AppearanceModel:
    """Return a model without samples, for ``sample_count`` ≤ 255 samples a pixel."""
    shape = (region.height, region.width)
    return AppearanceModel(
        region,
        np.zeros((*shape, 3, sample_count), np.uint8),
        np.zeros(shape, np.uint8),
        np.zeros(shape, np.uint8),
        np.zeros(shape, np.uint8),
        np.zeros((*shape, 2), np.float32),
    )


def warp_model(model: AppearanceModel, new_region: Region, motion: Array) -> AppearanceModel:
    """Move a model to the next frame by the layer's own motion.

    Parameters
    ----------
    model : AppearanceModel
        At frame t−1; left as it is. If no stack moves, as while the camera rests, its arrays are shared.
    new_region : Region
        The layer's region at frame t.
    motion : (new height, new width, 2) float32
        Backward motion t → t−1 at the pixels of the new region, px.

    Returns
    -------
    AppearanceModel
        At frame t; unknown (count 0) where the source is outside the old region.

    Notes
    -----
    Paper §6.1; see :mod:`mlbs_actors.appearance.warp`.
    """
    old = model.region
    shift_x, shift_y = new_region.x - old.x, new_region.y - old.y
    moved = moved_stacks(
        model.samples, model.count, model.newest, model.spread, model.residual, shift_x, shift_y, motion
    )
    return AppearanceModel(new_region, *moved)


@compiled
def moved_stacks(
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array, shift_x: int, shift_y: int,
    motion: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Move the arrays as :func:`warp_model`, for a region offset by this from the old one's corner."""
    source, new_residual = nearest_sources(residual, shift_x, shift_y, motion)
    if _stays(source, count):
        return samples, count, newest, spread, new_residual
    shape, size = source.shape, 3 * samples.shape[3]
    new_samples = np.empty((shape[0], shape[1], 3, samples.shape[3]), np.uint8)
    new_count, new_newest = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
    new_spread = np.empty(shape, np.uint8)
    sources = (source.reshape(-1), count.reshape(-1), newest.reshape(-1), spread.reshape(-1))
    room = (new_count.reshape(-1), new_newest.reshape(-1), new_spread.reshape(-1))
    old, new = samples.reshape(-1), new_samples.reshape(-1)
    if size % 8 == 0:  # in words: fewer copies
        _take_over(sources, old.view(np.uint64), size // 8, room, new.view(np.uint64))
    else:
        _take_over(sources, old, size, room, new)
    return new_samples, new_count, new_newest, new_spread, new_residual


@compiled
def _stays(source: Array, count: Array) -> bool:
    """Tell whether every pixel has a stack, and takes its own over."""
    if source.shape != count.shape:
        return False
    places, counts, others = source.reshape(-1), count.reshape(-1), 0
    for pixel in range(places.size):
        others += (places[pixel] != pixel) | (counts[pixel] == 0)
    return bool(others == 0)


@compiled
def _take_over(
    sources: tuple[Array, Array, Array, Array],
    old: Array,
    words: int,
    room: tuple[Array, Array, Array],
    new: Array,
) -> None:
    """Move stacks of ``words`` words, with their counts and spreads, from the places in ``source``."""
    source, count, newest, spread = sources
    new_count, new_newest, new_spread = room
    for pixel in range(source.size):
        place = source[pixel]
        if place < 0 or count[place] == 0:  # unknown stacks are 0, and need not be read
            for word in range(words):
                new[np.uint64(pixel * words + word)] = 0
            new_count[pixel], new_newest[pixel], new_spread[pixel] = 0, 0, 0
            continue
        if words == _USUAL_WORDS:
            first, new_first = np.uint64(place * _USUAL_WORDS), np.uint64(pixel * _USUAL_WORDS)
            for word in range(_USUAL_WORDS):
                new[new_first + np.uint64(word)] = old[first + np.uint64(word)]
        else:
            for word in range(words):
                new[np.uint64(pixel * words + word)] = old[np.uint64(place * words + word)]
        new_count[pixel], new_newest[pixel], new_spread[pixel] = count[place], newest[place], spread[place]


def update(model: AppearanceModel, image: Array, mask: Array) -> None:
    """Add a frame's colours to the model, in place, where the layer won the pixel (step 5 of a frame).

    Parameters
    ----------
    model : AppearanceModel
        At the frame's time.
    image : (h, w, 3) uint8
        The frame cut to the model's region, BGR.
    mask : (h, w) bool
        The layer's pixels in the published map. A full stack forgets its oldest sample.
    """
    image = np.ascontiguousarray(image)
    learn_colours(model.samples, model.count, model.newest, model.spread, model.residual, image, mask)


@compiled
def learn_colours(
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array, image: Array, mask: Array
) -> None:
    """Apply :func:`update` to a model's arrays."""
    capacity, width = samples.shape[3], mask.shape[1]
    half, third, rate = np.float32(0.5), np.float32(1 / (3 * SPREAD_STEP)), np.float32(_SPREAD_RATE)
    planes, colours, won = padded_planes(image), row_room(width), np.empty(width, np.int64)
    for y in range(mask.shape[0]):
        found, learning = 0, mask[y]
        for x in range(width):
            won[found] = x  # kept if it counts; a branch would be mispredicted
            found += int(learning[np.uint64(x)])
        if found == 0:
            continue
        for x in won[:found]:
            if count[y, x] == 0:
                residual[y, x, 0], residual[y, x, 1] = 0, 0
        read_row(planes, y, residual, won[0], won[found - 1] + 1, colours)
        for x in won[:found]:
            stack, known, slot = samples[y, x], int(count[y, x]), 0
            blue, green, red = colours[0, x], colours[1, x], colours[2, x]
            if known > 0:
                last = int(newest[y, x])
                slot = last + 1 if last + 1 < capacity else 0
                difference = (
                    abs(blue - np.float32(stack[0, last]))
                    + abs(green - np.float32(stack[1, last]))
                    + abs(red - np.float32(stack[2, last]))
                )
                # The running median moves towards the new difference and never past it.
                old = np.float32(spread[y, x])
                step = min(max(difference * third - old, -rate), rate)
                spread[y, x] = np.uint8(np.int32(min(old + step + half, np.float32(255))))
            # via int32, which takes one instruction
            stack[0, slot] = np.uint8(np.int32(blue + half))
            stack[1, slot] = np.uint8(np.int32(green + half))
            stack[2, slot] = np.uint8(np.int32(red + half))
            newest[y, x] = np.uint8(slot)
            count[y, x] = np.uint8(min(known + 1, capacity))


def relight(model: AppearanceModel, light: Array) -> None:
    """Give the samples, in place, the light of a new frame.

    What had been cut off at 0 or 255, and no longer would be, is forgotten: nobody knows what it was.

    Parameters
    ----------
    model : AppearanceModel
    light : (3, 256) uint8
        What each value of blue, green and red has become (:mod:`mlbs_actors.footage.light`).
    """
    _relight(model.samples, model.count, model.newest, light)


@compiled
def _relight(samples: Array, count: Array, newest: Array, light: Array) -> None:
    for y in range(count.shape[0]):
        for x in range(count.shape[1]):
            known, last, cut_off = int(count[y, x]), int(newest[y, x]), False
            for channel in range(3):
                if known > 0:
                    value = samples[y, x, channel, last]
                    cut_off |= (value == 0 or value == 255) and abs(
                        int(light[channel, value]) - int(value)
                    ) > 2
                for number in range(known):
                    samples[y, x, channel, number] = light[channel, samples[y, x, channel, number]]
            if cut_off:
                count[y, x] = 0


def median_colours(model: AppearanceModel) -> Array:
    """Return the median of each pixel's samples by channel: the lower one of two; 0 where there are none.

    Returns
    -------
    (h, w, 3) uint8
        BGR.
    """
    colours = np.zeros(model.samples.shape[:3], np.uint8)
    _medians(model.samples, model.count, colours)
    return colours


@compiled
def _medians(samples: Array, count: Array, colours: Array) -> None:
    ordered = np.empty(samples.shape[3], np.uint8)
    for y in range(count.shape[0]):
        for x in range(count.shape[1]):
            known = np.int64(count[y, x])  # signed, as an index counts down to 0
            if known == 0:
                continue
            for channel in range(3):
                for number in range(known):
                    sample = samples[y, x, channel, number]
                    place = number
                    while place > 0 and ordered[place - 1] > sample:
                        ordered[place] = ordered[place - 1]
                        place -= 1
                    ordered[place] = sample
                colours[y, x, channel] = ordered[(known - 1) // 2]
