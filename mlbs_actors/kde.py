"""Per-pixel appearance of one layer: kernel density estimation over the last N colours (§5, §6.2).

The density of a colour c at a pixel with the samples c_1 … c_n is

    p(c) = 1/n Σ_f Π_ch N(c_ch; c_f,ch, σ²)          nats per unit RGB volume (1/level³) after the log,

optionally averaged over the stacks of a (2·radius+1)² window with Gaussian weights, against what is left
of a registration error; stacks without samples take no part.

**Bandwidth.** σ is one for the three channels of a pixel: the running median of the mean absolute difference
between a sample and the one before it (a median |a − b| of two Gaussian values is 0.95 σ; the mean over
three independent channels has its median at 1.1 σ, over three equal ones at 0.95 σ: it is taken as σ),
with a floor. A true median of N differences a pixel and frame costs more than the whole evaluation; the
running one moves by half a level a frame towards the new difference.

**Sub-pixel position.** The stack at pixel i describes the point i + r(i) (see :mod:`mlbs_actors.warp`), so the
frame is read at i + r(i) too, bilinearly, both to evaluate and to learn: a sample is interpolated once in
its life and only moved afterwards.

**Unknown is not unlikely.** A pixel without samples has no likelihood: NaN, with confidence 0.
:func:`borrowed_log_likelihood` gives it that of the nearest stack that is known, with a confidence that decays with
the distance.

Differs from the paper: samples move by integer pixels with a residual (the paper does not say); the sum is
divided by the number of samples (the published MATLAB's is not, an accidental prior); colours are plain BGR
(there: normalised red, green and intensity); the exponential is evaluated as (1 − q/256 + (q/256)²/2)²⁵⁶
with q ≤ 40, less than 0.02 nats from exact for q ≤ 20, because that runs in vector registers; a kernel sum is
so never below e⁻⁴⁰.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from mlbs_actors.messages import Array, Region
from mlbs_actors.warp import nearest_source

__all__ = [
    "AppearanceModel",
    "AppearanceParameters",
    "borrowed_log_likelihood",
    "confidence",
    "empty_model",
    "log_likelihood",
    "update",
    "warp_and_evaluate",
    "warp_model",
]

#: Unit of ``AppearanceModel.spread``, grey levels.
SPREAD_STEP = 1.0 / 8.0
#: How far the running median moves a frame, in units of ``SPREAD_STEP``.
_SPREAD_RATE = 4
_MAX_EXPONENT = np.float32(40.0)


@dataclass(frozen=True, slots=True)
class AppearanceParameters:
    """What the density estimate hangs on.

    Attributes
    ----------
    bandwidth_floor : float
        Smallest kernel standard deviation σ, grey levels, > 0.
    window_radius : int
        Radius of the window of stacks that a colour is compared with, px; 0 is the pixel's own stack alone.
    window_std : float
        Standard deviation of the window's Gaussian weights, px.
    half_confidence_samples : float
        Number of samples at which a stack's confidence is one half.
    borrow_bandwidth_floor : float
        The same as ``bandwidth_floor`` for borrowed stacks, grey levels: colours vary more from place to place
        than in time.
    borrow_scale : float
        Distance at which the confidence of a borrowed stack has fallen to 1/e, px.
    """

    bandwidth_floor: float = 5.0
    window_radius: int = 0
    window_std: float = 0.7
    half_confidence_samples: float = 2.0
    borrow_bandwidth_floor: float = 12.0
    borrow_scale: float = 8.0


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


def confidence(count: Array, parameters: AppearanceParameters) -> Array:
    """Trust in stacks of ``count`` samples: n / (n + n_half), in [0, 1), float32, 0 where nothing is known."""
    samples = count.astype(np.float32)
    trust: Array = samples / (samples + np.float32(parameters.half_confidence_samples))
    return trust


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
    moved = _uninitialised(new_region, model.samples.shape[3])
    for_rows = (0, new_region.height)
    _warp_rows(*_arrays(model), *_arrays(moved), motion, *_shift(model.region, new_region), *for_rows)
    return moved


def log_likelihood(
    model: AppearanceModel, image: Array, parameters: AppearanceParameters, needed: Array | None = None
) -> Array:
    """Log density of the frame's colours under a model of the same frame.

    Parameters
    ----------
    model : AppearanceModel
        At the frame's time: moved by :func:`warp_model`.
    image : (h, w, 3) uint8
        The frame cut to the model's region, BGR.
    parameters : AppearanceParameters
    needed : (h, w) bool, optional
        Where to evaluate; everywhere by default.

    Returns
    -------
    (h, w) float32
        Nats per unit RGB volume; NaN where nothing is known or ``needed`` is false.

    Notes
    -----
    Paper §6.2, P(I|l) = 1/N Σ_f K_G(I − I_f).
    """
    result = np.empty(model.count.shape, np.float32)
    needed = np.ones(model.count.shape, np.bool_) if needed is None else needed
    rows = (0, model.region.height)
    _evaluate_rows(*_arrays(model), image, needed, *_tables(parameters), result, *rows)
    return result


def warp_and_evaluate(
    model: AppearanceModel,
    new_region: Region,
    motion: Array,
    image: Array,
    parameters: AppearanceParameters,
    needed: Array | None = None,
) -> tuple[AppearanceModel, Array]:
    """:func:`warp_model` and :func:`log_likelihood` in one pass over the samples, with the same results.

    Parameters
    ----------
    model : AppearanceModel
        At frame t−1; left as it is.
    new_region : Region
    motion : (h, w, 2) float32
        Backward motion on the new region, px.
    image : (h, w, 3) uint8
        Frame t cut to the new region, BGR.
    parameters : AppearanceParameters
    needed : (h, w) bool, optional
        Where to evaluate; everywhere by default. The model is moved everywhere.

    Returns
    -------
    model : AppearanceModel
        At frame t.
    log_likelihood : (h, w) float32
        As :func:`log_likelihood` returns.
    """
    moved = _uninitialised(new_region, model.samples.shape[3])
    result = np.empty(moved.count.shape, np.float32)
    needed = np.ones(moved.count.shape, np.bool_) if needed is None else needed
    shift = _shift(model.region, new_region)
    _warp_and_evaluate(
        _arrays(model), _arrays(moved), motion, *shift, image, needed, *_tables(parameters), result
    )
    return moved, result


def borrowed_log_likelihood(
    model: AppearanceModel, image: Array, parameters: AppearanceParameters, needed: Array
) -> tuple[Array, Array]:
    """Log density under the nearest known stack, for the pixels that have none of their own.

    Parameters
    ----------
    model : AppearanceModel
        At the frame's time.
    image : (h, w, 3) uint8
        The frame cut to the model's region, BGR.
    parameters : AppearanceParameters
    needed : (h, w) bool
        Where an answer is wanted; only unknown pixels among them get one.

    Returns
    -------
    log_likelihood : (h, w) float32
        Nats per unit RGB volume; NaN at known or unneeded pixels and for a model that knows nothing.
    confidence : (h, w) float32
        That of the stack times exp(−distance / ``borrow_scale``); 0 where the likelihood is NaN. The
        distance is the 5×5 chamfer one, within 2 % of the Euclidean.
    """
    result = np.full(model.count.shape, np.nan, np.float32)
    trust = np.zeros(model.count.shape, np.float32)
    unknown = model.count == 0
    wanted = unknown & needed
    if unknown.all() or not wanted.any():
        return result, trust
    distance, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    lender = np.zeros(int(label.max()) + 1, np.int32)
    lender[label[~unknown]] = np.flatnonzero(~unknown)
    rows, columns = np.nonzero(wanted)
    lenders = lender[label[rows, columns]]
    inverse, log_norm, weights = _tables(parameters, parameters.borrow_bandwidth_floor)
    values = np.empty(rows.size, np.float32)
    _evaluate_points(
        *_arrays(model), image[rows, columns], lenders // unknown.shape[1], lenders % unknown.shape[1],
        inverse, log_norm, weights, values,
    )  # fmt: skip
    result[rows, columns] = values
    decay = np.exp(-distance[rows, columns] / np.float32(parameters.borrow_scale))
    trust[rows, columns] = confidence(model.count.ravel()[lenders], parameters) * decay
    return result, trust


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
    _update(*_arrays(model), image, mask)


def _arrays(model: AppearanceModel) -> tuple[Array, Array, Array, Array, Array]:
    return model.samples, model.count, model.newest, model.spread, model.residual


def _uninitialised(region: Region, sample_count: int) -> AppearanceModel:
    """Model whose arrays are still to be written, every element of them."""
    shape = (region.height, region.width)
    return AppearanceModel(
        region,
        np.empty((*shape, 3, sample_count), np.uint8),
        np.empty(shape, np.uint8),
        np.empty(shape, np.uint8),
        np.empty(shape, np.uint8),
        np.empty((*shape, 2), np.float32),
    )


def _shift(old_region: Region, new_region: Region) -> tuple[int, int]:
    return new_region.x - old_region.x, new_region.y - old_region.y


def _tables(parameters: AppearanceParameters, floor: float | None = None) -> tuple[Array, Array, Array]:
    """1/(2σ²)/256 and −3 log(σ√2π) for each of the 256 values of ``spread``, and the window's weights."""
    floor = parameters.bandwidth_floor if floor is None else floor
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, floor)
    inverse = (1.0 / (2.0 * bandwidth**2) / 256.0).astype(np.float32)
    log_norm = (-3.0 * np.log(bandwidth * np.sqrt(2.0 * np.pi))).astype(np.float32)
    offset = np.arange(-parameters.window_radius, parameters.window_radius + 1)
    profile = np.exp(-(offset**2) / (2.0 * parameters.window_std**2))
    return inverse, log_norm, np.outer(profile, profile).astype(np.float32)


@njit(cache=True)
def _read_image(image: Array, y: float, x: float) -> tuple[float, float, float]:
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


@njit(cache=True, inline="always")
def _kernel_mean(
    samples: Array, y: int, x: int, count: int, colour: tuple[float, float, float], inverse: float, kernel: Array
) -> float:
    """Mean over a stack's samples of exp(−|c − c_f|² / 2σ²); ``inverse`` is 1/(2σ²)/256."""
    blue, green, red = colour
    one, half, largest = np.float32(1), np.float32(0.5), _MAX_EXPONENT / np.float32(256)
    # All slots are evaluated, into a buffer: this loop has no branch and no sum, so it is vectorised.
    for slot in range(samples.shape[3]):
        d_blue = np.float32(samples[y, x, 0, slot]) - blue
        d_green = np.float32(samples[y, x, 1, slot]) - green
        d_red = np.float32(samples[y, x, 2, slot]) - red
        part = min((d_blue * d_blue + d_green * d_green + d_red * d_red) * inverse, largest)
        value = one - part + half * part * part
        value *= value  # 2
        value *= value  # 4
        value *= value  # 8
        value *= value  # 16
        value *= value  # 32
        value *= value  # 64
        value *= value  # 128
        value *= value  # 256
        kernel[slot] = value
    total = np.float32(0)
    for slot in range(count):
        total += kernel[slot]
    return total / np.float32(count)


@njit(cache=True, inline="always")
def _log_density(
    samples: Array, count: Array, spread: Array, y: int, x: int, colour: tuple[float, float, float],
    inverse: Array, log_norm: Array, weights: Array, kernel: Array,
) -> float:  # fmt: skip
    """Log density of a colour under the window of stacks around a known pixel (y, x)."""
    radius = weights.shape[0] // 2
    if radius == 0:
        scale = spread[y, x]
        mean = _kernel_mean(samples, y, x, count[y, x], colour, inverse[scale], kernel)
        return np.log(mean) + log_norm[scale]
    total, weight = np.float32(0), np.float32(0)
    for row in range(max(y - radius, 0), min(y + radius + 1, count.shape[0])):
        for column in range(max(x - radius, 0), min(x + radius + 1, count.shape[1])):
            if count[row, column] > 0:
                scale = spread[row, column]
                share = weights[row - y + radius, column - x + radius]
                mean = _kernel_mean(samples, row, column, count[row, column], colour, inverse[scale], kernel)
                total += share * mean * np.exp(log_norm[scale])
                weight += share
    return np.log(total / weight)


@njit(cache=True)
def _evaluate_rows(
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array, image: Array, needed: Array,
    inverse: Array, log_norm: Array, weights: Array, result: Array, first: int, stop: int,
) -> None:  # fmt: skip
    kernel = np.empty(samples.shape[3], np.float32)
    for y in range(first, stop):
        for x in range(result.shape[1]):
            if not needed[y, x] or count[y, x] == 0:
                result[y, x] = np.nan
                continue
            colour = _read_image(image, y + residual[y, x, 1], x + residual[y, x, 0])
            result[y, x] = _log_density(
                samples, count, spread, y, x, colour, inverse, log_norm, weights, kernel
            )


@njit(cache=True)
def _evaluate_points(
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array, colours: Array,
    rows: Array, columns: Array, inverse: Array, log_norm: Array, weights: Array, result: Array,
) -> None:  # fmt: skip
    kernel = np.empty(samples.shape[3], np.float32)
    for point in range(rows.size):
        colour = (
            np.float32(colours[point, 0]),
            np.float32(colours[point, 1]),
            np.float32(colours[point, 2]),
        )
        result[point] = _log_density(
            samples, count, spread, rows[point], columns[point], colour, inverse, log_norm, weights, kernel
        )


@njit(cache=True)
def _warp_rows(
    old_samples: Array, old_count: Array, old_newest: Array, old_spread: Array, old_residual: Array,
    samples: Array, count: Array, newest: Array, spread: Array, residual: Array,
    motion: Array, shift_x: int, shift_y: int, first: int, stop: int,
) -> None:  # fmt: skip
    old_height, old_width, height, width = *old_count.shape, *count.shape
    stack = samples.shape[2] * samples.shape[3]
    old_bytes = old_samples.reshape(old_height * old_width * stack)
    new_bytes = samples.reshape(height * width * stack)
    source = np.empty(width, np.int64)
    for y in range(first, stop):
        for x in range(width):
            source_x = np.float64(x + shift_x) + motion[y, x, 0]
            source_y = np.float64(y + shift_y) + motion[y, x, 1]
            row, column = nearest_source(old_residual, source_y, source_x)
            if row < 0:
                source[x] = -1
                count[y, x], newest[y, x], spread[y, x] = 0, 0, 0
                residual[y, x, 0], residual[y, x, 1] = 0, 0
                continue
            source[x] = row * old_width + column
            count[y, x] = old_count[row, column]
            newest[y, x] = old_newest[row, column]
            spread[y, x] = old_spread[row, column]
            residual[y, x, 0] = column + old_residual[row, column, 0] - source_x
            residual[y, x, 1] = row + old_residual[row, column, 1] - source_y
        # Neighbours mostly take over neighbouring stacks: they are copied run by run, not one by one.
        start = 0
        while start < width:
            end = start + 1
            while end < width and source[end] >= 0 and source[end] == source[end - 1] + 1:
                end += 1
            target = (y * width + start) * stack
            if source[start] < 0:
                new_bytes[target : target + stack] = 0
                end = start + 1
            else:
                origin = source[start] * stack
                length = (end - start) * stack
                new_bytes[target : target + length] = old_bytes[origin : origin + length]
            start = end


@njit(cache=True)
def _warp_and_evaluate(
    old: tuple[Array, Array, Array, Array, Array], new: tuple[Array, Array, Array, Array, Array],
    motion: Array, shift_x: int, shift_y: int, image: Array, needed: Array,
    inverse: Array, log_norm: Array, weights: Array, result: Array,
) -> None:  # fmt: skip
    """Row by row, the evaluation just behind the move, so that it finds the samples in the cache."""
    height, radius = result.shape[0], weights.shape[0] // 2
    for y in range(height + radius):
        if y < height:
            _warp_rows(*old, *new, motion, shift_x, shift_y, y, y + 1)
        if y >= radius:
            _evaluate_rows(
                *new, image, needed, inverse, log_norm, weights, result, y - radius, y - radius + 1
            )


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
            colour = _read_image(image, y + residual[y, x, 1], x + residual[y, x, 0])
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
