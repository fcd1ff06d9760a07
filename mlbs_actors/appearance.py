"""What a layer remembers of its appearance: the last N colours of every pixel (§6).

A *stack* holds a pixel's samples; :mod:`mlbs_actors.kde` turns it into a density. Each frame it is moved by
the layer's motion (:func:`warp_model`) and learns the pixels that the layer won (:func:`update`).

**Spread.** A stack keeps the running median of the mean absolute difference between a sample and the one
before it, the kernel's bandwidth. A true median of N differences a pixel and frame costs more than the
whole evaluation; the running one moves by at most half a grey level a frame towards the new difference.

**Sub-pixel position.** The stack at pixel i describes the point i + r(i) (see :mod:`mlbs_actors.warp`), so
the frame is read at i + r(i) too, bilinearly, to learn and to evaluate: a sample is interpolated once in its
life and only moved afterwards.

Differs from the paper: it does not say how stacks are moved by fractions of a pixel, nor what replaces the
oldest sample's place in time: here each pixel forgets its own oldest, whenever it was learnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mlbs_actors.messages import Array, Region
from mlbs_actors.warp import nearest_sources

__all__ = ["SPREAD_STEP", "AppearanceModel", "empty_model", "read_image", "update", "warp_model"]

#: Unit of ``AppearanceModel.spread``, grey levels.
SPREAD_STEP = 1.0 / 8.0
#: How far the running median moves a frame, in units of ``SPREAD_STEP``.
_SPREAD_RATE = 4


@dataclass(frozen=True, slots=True)
class AppearanceModel:
    """The colours of one layer on its region. The arrays are the state: :func:`update` writes into them.

    Attributes
    ----------
    region : Region
        Where the stacks live in the frame.
    samples : (h, w, 3, N) uint8
        Colours, BGR; the first ``count`` are valid.
    count : (h, w) uint8
        Number of samples, 0 (unknown) … N.
    newest : (h, w) uint8
        Index of the newest sample.
    spread : (h, w) uint8
        Running median of the successive differences, in units of ``SPREAD_STEP`` grey levels.
    residual : (h, w, 2) float32
        Where (x, y) the described point lies from the pixel's centre, px.
    """

    region: Region
    samples: Array
    count: Array
    newest: Array
    spread: Array
    residual: Array


def empty_model(region: Region, sample_count: int = 20) -> AppearanceModel:
    """Return a model that knows nothing, for ``sample_count`` ≤ 255 samples a pixel."""
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
        At frame t−1; left as it is.
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
    Paper §6.1; see :mod:`mlbs_actors.warp`.
    """
    if model.region.area == 0:
        return empty_model(new_region, model.samples.shape[3])
    source, residual = nearest_sources(model.residual, model.region, new_region, motion)
    has_source = source >= 0
    # Where nothing is taken over, the first stack serves as a harmless filling behind the count of 0.
    source = np.maximum(source, 0)
    stacks = model.samples.reshape(model.region.area, -1)
    samples = np.take(stacks, source.ravel(), axis=0).reshape(*source.shape, *model.samples.shape[2:])
    count, newest, spread = (
        np.take(a, source) * has_source for a in (model.count, model.newest, model.spread)
    )
    return AppearanceModel(new_region, samples, count, newest, spread, residual)


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
    _update(model.samples, model.count, model.newest, model.spread, model.residual, image, mask)


@njit(cache=True)
def read_image(image: Array, y: float, x: float) -> tuple[float, float, float]:
    """Bilinear colour at a sub-pixel position, held inside the image."""
    height, width = image.shape[0], image.shape[1]
    y = min(max(y, 0.0), height - 1.0)
    x = min(max(x, 0.0), width - 1.0)
    top, left = int(y), int(x)
    bottom, right = min(top + 1, height - 1), min(left + 1, width - 1)
    down, along = np.float32(y - top), np.float32(x - left)
    up, back = np.float32(1) - down, np.float32(1) - along
    w00, w01, w10, w11 = up * back, up * along, down * back, down * along
    return (
        w00 * image[top, left, 0] + w01 * image[top, right, 0]
        + w10 * image[bottom, left, 0] + w11 * image[bottom, right, 0],
        w00 * image[top, left, 1] + w01 * image[top, right, 1]
        + w10 * image[bottom, left, 1] + w11 * image[bottom, right, 1],
        w00 * image[top, left, 2] + w01 * image[top, right, 2]
        + w10 * image[bottom, left, 2] + w11 * image[bottom, right, 2],
    )  # fmt: skip


@njit(cache=True)
def _update(
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array, image: Array, mask: Array
) -> None:
    capacity = samples.shape[3]
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if not mask[y, x]:
                continue
            if count[y, x] == 0:
                residual[y, x, 0], residual[y, x, 1] = 0, 0
            colour = read_image(image, y + residual[y, x, 1], x + residual[y, x, 0])
            slot = 0
            if count[y, x] > 0:
                last = newest[y, x]
                slot = (last + 1) % capacity
                difference = np.float32(0)
                for channel in range(3):
                    difference += abs(colour[channel] - np.float32(samples[y, x, channel, last]))
                # The running median steps towards the new difference and never past it.
                old = np.float32(spread[y, x])
                step = difference / np.float32(3 * SPREAD_STEP) - old
                step = min(max(step, np.float32(-_SPREAD_RATE)), np.float32(_SPREAD_RATE))
                spread[y, x] = np.uint8(min(np.floor(old + step + np.float32(0.5)), np.float32(255)))
            for channel in range(3):
                samples[y, x, channel, slot] = np.uint8(colour[channel] + np.float32(0.5))
            newest[y, x] = slot
            count[y, x] = min(count[y, x] + 1, capacity)
