"""How likely the frame's colours are under a layer: kernel density estimation, pixel by pixel (§6.2).

The density of a colour c at a pixel with the samples c_1 … c_n is

    p(c) = 1/n Σ_f Π_ch N(c_ch; c_f,ch, σ²)          nats per unit RGB volume (1/level³) after the log,

optionally averaged over the stacks of a (2·radius+1)² window with Gaussian weights, against what is left
of a registration error; stacks without samples take no part.

**Bandwidth.** σ is one for the three channels of a pixel: the stack's running median of the mean absolute
successive difference, with a floor. (A median |a − b| of two Gaussian values is 0.95 σ; the mean over three
independent channels has its median at 1.1 σ, over three equal ones at 0.95 σ: it is taken as σ.) Where the
image is steep a model that is a little out of place errs by much: there the floor is √(σ_min² + (e·|∇I|)²),
e the registration error. Without it outlines and textures contradict the model of a turning object.

**Unknown is not unlikely.** A pixel without samples has no likelihood: NaN, with confidence 0.

Differs from the paper: the sum is divided by the number of samples (the published MATLAB's is not, an
accidental prior); colours are plain BGR (there: normalised red, green and intensity); the exponential is
evaluated as (1 − q/256 + (q/256)²/2)²⁵⁶ with q ≤ 40, less than 0.02 nats from exact for q ≤ 18, because that
runs in vector registers; a kernel is so never below e⁻⁴⁰.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit

from mlbs_actors.appearance import SPREAD_STEP, AppearanceModel, read_image, warp_model
from mlbs_actors.messages import Array, Region

__all__ = [
    "AppearanceParameters",
    "confidence",
    "log_likelihood",
    "warp_and_evaluate",
]

#: Larger exponents q are cut off here: the kernel is never below e⁻⁴⁰.
_MAX_EXPONENT = np.float32(40.0)


@dataclass(frozen=True, slots=True)
class AppearanceParameters:
    """What the density estimate hangs on.

    Attributes
    ----------
    bandwidth_floor : float
        Smallest kernel standard deviation σ, grey levels, > 0.
    registration_px : float
        Standard deviation of the model's registration error, px.
    window_radius : int
        Radius of the window of stacks that a colour is compared with, px; 0 is the pixel's own stack alone.
    window_std : float
        Standard deviation of the window's Gaussian weights, px.
    half_confidence_samples : float
        Number of samples at which a stack's confidence is one half.
    """

    bandwidth_floor: float = 5.0
    registration_px: float = 0.0
    window_radius: int = 0
    window_std: float = 0.7
    half_confidence_samples: float = 2.0


def confidence(count: Array, parameters: AppearanceParameters) -> Array:
    """Trust in stacks of ``count`` samples: n / (n + n_half), in [0, 1), float32."""
    samples = count.astype(np.float32)
    trust: Array = samples / (samples + np.float32(parameters.half_confidence_samples))
    return trust


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
    tables = _tables(parameters)
    _evaluate(model.samples, model.count, model.spread, model.residual, image, needed, *tables, result)
    return result


def warp_and_evaluate(
    model: AppearanceModel, new_region: Region, motion: Array, image: Array, parameters: AppearanceParameters
) -> tuple[AppearanceModel, Array]:
    """Predict the model of frame t and evaluate frame t under it everywhere (steps 3b and 3c of a frame).

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

    Returns
    -------
    model : AppearanceModel
        As :func:`warp_model` returns.
    log_likelihood : (h, w) float32
        As :func:`log_likelihood` returns.
    """
    moved = warp_model(model, new_region, motion)
    spread = np.maximum(moved.spread, _registration_spread(image, parameters))
    return moved, log_likelihood(replace(moved, spread=spread), image, parameters)


def _registration_spread(image: Array, parameters: AppearanceParameters) -> Array:
    """Least bandwidth of each pixel for the registration error, (h, w) uint8 in units of ``SPREAD_STEP``."""
    if image.size == 0 or parameters.registration_px == 0:
        return np.zeros(image.shape[:2], np.uint8)
    squared = np.zeros(image.shape[:2], np.float32)
    for across, down in ((1, 0), (0, 1)):
        slope = cv2.Sobel(image, cv2.CV_32F, across, down, scale=1 / 8)
        squared += np.square(np.abs(slope).max(axis=2))
    floor = np.sqrt(parameters.bandwidth_floor**2 + parameters.registration_px**2 * squared)
    return np.asarray(np.clip(np.rint(floor / SPREAD_STEP), 0, 255), np.uint8)


def _tables(parameters: AppearanceParameters) -> tuple[Array, Array, Array]:
    """1/(2σ²)/256 and (σ√2π)⁻³ for each of the 256 values of ``spread``, and the window's weights."""
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, parameters.bandwidth_floor)
    inverse = (1.0 / (2.0 * bandwidth**2) / 256.0).astype(np.float32)
    norm = ((bandwidth * np.sqrt(2.0 * np.pi)) ** -3).astype(np.float32)
    offset = np.arange(-parameters.window_radius, parameters.window_radius + 1)
    profile = np.exp(-(offset**2) / (2.0 * parameters.window_std**2))
    return inverse, norm, np.outer(profile, profile).astype(np.float32)


@njit(cache=True)
def _kernel_means(
    samples: Array, count: Array, rows: Array, columns: Array, colours: Array, inverse: Array, means: Array
) -> None:
    """Mean over the samples at each of n points of exp(−|c − c_f|² / 2σ²); ``inverse`` is 1/(2σ²)/256.

    This is where the time goes. All slots are evaluated, into a buffer: the inner loop has no branch and no
    sum, so it is vectorised.
    """
    one, half, largest = np.float32(1), np.float32(0.5), _MAX_EXPONENT / np.float32(256)
    kernel = np.empty(samples.shape[3], np.float32)
    for point in range(rows.size):
        y, x = rows[point], columns[point]
        blue, green, red, scale = colours[point, 0], colours[point, 1], colours[point, 2], inverse[point]
        for slot in range(samples.shape[3]):
            d_blue = np.float32(samples[y, x, 0, slot]) - blue
            d_green = np.float32(samples[y, x, 1, slot]) - green
            d_red = np.float32(samples[y, x, 2, slot]) - red
            part = min((d_blue * d_blue + d_green * d_green + d_red * d_red) * scale, largest)
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
        for slot in range(count[y, x]):
            total += kernel[slot]
        means[point] = total / np.float32(max(count[y, x], 1))


@njit(cache=True)
def _log_densities(
    samples: Array, count: Array, spread: Array, rows: Array, columns: Array, colours: Array,
    inverse: Array, norm: Array, weights: Array, result: Array,
) -> None:  # fmt: skip
    """Log density of n colours (n, 3) under the windows of stacks around n known pixels."""
    size, radius = rows.size, weights.shape[0] // 2
    total, weight = np.zeros(size, np.float32), np.zeros(size, np.float32)
    near_rows, near_columns = np.empty(size, np.int64), np.empty(size, np.int64)
    scales, shares = np.empty(size, np.float32), np.empty(size, np.float32)
    means = np.empty(size, np.float32)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            for point in range(size):
                row = min(max(rows[point] + v, 0), count.shape[0] - 1)
                column = min(max(columns[point] + u, 0), count.shape[1] - 1)
                inside = row == rows[point] + v and column == columns[point] + u
                near_rows[point], near_columns[point] = row, column
                scales[point] = inverse[spread[row, column]]
                known = inside and count[row, column] > 0
                shares[point] = weights[v + radius, u + radius] if known else np.float32(0)
            _kernel_means(samples, count, near_rows, near_columns, colours, scales, means)
            for point in range(size):
                density = means[point] * norm[spread[near_rows[point], near_columns[point]]]
                total[point] += shares[point] * density
                weight[point] += shares[point]
    for point in range(size):
        result[point] = np.log(total[point] / weight[point])


@njit(cache=True)
def _evaluate(
    samples: Array, count: Array, spread: Array, residual: Array, image: Array, needed: Array,
    inverse: Array, norm: Array, weights: Array, result: Array,
) -> None:  # fmt: skip
    """Row by row: gather the pixels to evaluate, evaluate them, scatter."""
    width = result.shape[1]
    rows, columns = np.empty(width, np.int64), np.empty(width, np.int64)
    colours, values = np.empty((width, 3), np.float32), np.empty(width, np.float32)
    for y in range(result.shape[0]):
        size = 0
        for x in range(width):
            result[y, x] = np.nan
            if needed[y, x] and count[y, x] > 0:
                rows[size], columns[size] = y, x
                colour = read_image(image, y + residual[y, x, 1], x + residual[y, x, 0])
                colours[size, 0], colours[size, 1], colours[size, 2] = colour
                size += 1
        _log_densities(
            samples,
            count,
            spread,
            rows[:size],
            columns[:size],
            colours[:size],
            inverse,
            norm,
            weights,
            values,
        )
        for point in range(size):
            result[y, columns[point]] = values[point]
