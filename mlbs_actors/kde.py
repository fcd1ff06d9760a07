"""How likely the frame's colours are under a layer: kernel density estimation, pixel by pixel (§6.2).

The density of a colour c at a pixel with the samples c_1 … c_n is

    p(c) = 1/n Σ_f Π_ch N(c_ch; c_f,ch, σ²)          nats per unit RGB volume (1/level³) after the log.

**Bandwidth.** σ is one for the three channels of a pixel: the stack's running median of the mean absolute
successive difference, with a floor. (A median |a − b| of two Gaussian values is 0.95 σ; the mean over three
independent channels has its median at 1.1 σ, over three equal ones at 0.95 σ: it is taken as σ.) Where the
image is steep a model that is a little out of place errs by much: there the floor is √(σ_min² + (e·|∇I|)²),
e the registration error. Without it outlines and textures contradict the model of a turning object.

**Unknown is not unlikely.** A pixel without samples has no likelihood: NaN, with confidence 0.

Differs from the paper: the sum is divided by the number of samples (the published MATLAB's is not, an
accidental prior); colours are plain BGR (there: normalised red, green and intensity); exponential and
logarithm are polynomials, less than 1e-3 nats from exact together; a kernel is never below e⁻⁴⁰.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.polynomial import Chebyshev, Polynomial

from mlbs_actors.appearance import SPREAD_STEP, AppearanceModel, read_image, warp_model
from mlbs_actors.messages import Array, Region
from mlbs_actors.row_log import row_log

__all__ = [
    "AppearanceParameters",
    "confidence",
    "log_likelihood",
    "warp_and_evaluate",
]

#: Least logarithm of a kernel to base 2.
_LEAST = np.float32(-40.0 / np.log(2.0))
#: 2^z for −1 ≤ z ≤ 0.
_P0, _P1, _P2, _P3, _P4 = (
    np.float32(one)
    for one in Chebyshev.interpolate(np.exp2, 4, domain=[-1.0, 0.0]).convert(kind=Polynomial).coef
)


@dataclass(frozen=True, slots=True)
class AppearanceParameters:
    """What the density estimate hangs on.

    Attributes
    ----------
    bandwidth_floor : float
        Smallest kernel standard deviation σ, grey levels, > 0.
    registration : float
        Standard deviation of the model's registration error, pixels of its image.
    half_confidence_samples : float
        Number of samples at which a stack's confidence is one half.
    """

    bandwidth_floor: float = 5.0
    registration: float = 0.0
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
    result = np.full(model.count.shape, np.nan, np.float32)
    needed = np.ones(model.count.shape, np.bool_) if needed is None else needed
    _evaluate(
        model.samples,
        model.count,
        model.spread,
        model.residual,
        image,
        needed,
        np.float32(parameters.bandwidth_floor),
        np.float32(parameters.registration),
        *_tables(parameters),
        result,
    )
    return result


def warp_and_evaluate(
    model: AppearanceModel,
    new_region: Region,
    motion: Array,
    image: Array,
    parameters: AppearanceParameters,
    needed: Array | None = None,
) -> tuple[AppearanceModel, Array]:
    """Predict the model of frame t and evaluate frame t under it (steps 3b and 3c of a frame).

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
        Where to evaluate; everywhere by default. The model moves everywhere.

    Returns
    -------
    model : AppearanceModel
        As :func:`warp_model` returns.
    log_likelihood : (h, w) float32
        As :func:`log_likelihood` returns.
    """
    moved = warp_model(model, new_region, motion)
    return moved, log_likelihood(moved, image, parameters, needed)


@functools.lru_cache(maxsize=16)
def _tables(parameters: AppearanceParameters) -> tuple[Array, Array]:
    """Log to base 2 of a kernel per squared grey level, and (σ√2π)⁻³, for the 256 values of ``spread``."""
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, parameters.bandwidth_floor)
    exponent = (-1.0 / (2.0 * np.log(2.0) * bandwidth**2)).astype(np.float32)
    return exponent, ((bandwidth * np.sqrt(2.0 * np.pi)) ** -3).astype(np.float32)


@njit(cache=True)
def _least_spread(image: Array, y: int, x: int, floor: np.float32, registration: np.float32) -> int:
    """Least bandwidth of a pixel for the registration error, in units of ``SPREAD_STEP``.

    Slopes are Sobel's, of the image mirrored at its border; in each direction that of the steepest channel.
    """
    height, width = image.shape[0], image.shape[1]
    above, below = (y - 1 if y > 0 else min(1, height - 1)), (y + 1 if y + 1 < height else max(height - 2, 0))
    left, right = (x - 1 if x > 0 else min(1, width - 1)), (x + 1 if x + 1 < width else max(width - 2, 0))
    steepest_across, steepest_down = 0, 0
    for channel in range(3):
        top_left, top_right = int(image[above, left, channel]), int(image[above, right, channel])
        low_left, low_right = int(image[below, left, channel]), int(image[below, right, channel])
        across = (
            (top_right - top_left)
            + (low_right - low_left)
            + 2 * (int(image[y, right, channel]) - int(image[y, left, channel]))
        )
        down = (
            (low_left - top_left)
            + (low_right - top_right)
            + 2 * (int(image[below, x, channel]) - int(image[above, x, channel]))
        )
        steepest_across, steepest_down = max(steepest_across, abs(across)), max(steepest_down, abs(down))
    squared = np.float32(steepest_across * steepest_across + steepest_down * steepest_down) / np.float32(64)
    spread = np.sqrt(floor * floor + registration * registration * squared) / np.float32(SPREAD_STEP)
    return int(min(np.rint(spread), np.float32(255)))


@njit(cache=True)
def _evaluate(
    samples: Array, count: Array, spread: Array, residual: Array, image: Array, needed: Array,
    floor: np.float32, registration: np.float32, exponent: Array, norm: Array, result: Array,
) -> None:  # fmt: skip
    height, width = result.shape
    # A float's bits hold its exponent, so 2^n is an integer's shift. All slots, valid or not, and short
    # loops of nothing but arithmetic: these run in vector registers.
    kernel, bits = np.empty(samples.shape[3], np.float32), np.empty(samples.shape[3], np.int32)
    power = bits.view(np.float32)
    density, logs = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        density[:] = np.float32(1)
        for x in range(width):
            known = int(count[y, x])
            if not needed[y, x] or known == 0:
                continue
            blue, green, red = read_image(image, y, x, residual[y, x, 0], residual[y, x, 1])
            width_index = int(spread[y, x])
            if registration > 0:
                width_index = max(width_index, _least_spread(image, y, x, floor, registration))
            scale = exponent[width_index]
            blues, greens, reds = samples[y, x, 0], samples[y, x, 1], samples[y, x, 2]
            for slot in range(kernel.size):
                d_blue, d_green = np.float32(blues[slot]) - blue, np.float32(greens[slot]) - green
                d_red = np.float32(reds[slot]) - red
                kernel[slot] = max((d_blue * d_blue + d_green * d_green + d_red * d_red) * scale, _LEAST)
            for slot in range(kernel.size):
                bits[slot] = np.int32(kernel[slot])
            for slot in range(kernel.size):
                z = kernel[slot] - np.float32(bits[slot])
                kernel[slot] = _P0 + z * (_P1 + z * (_P2 + z * (_P3 + z * _P4)))
            for slot in range(kernel.size):
                bits[slot] = (bits[slot] + np.int32(127)) << np.int32(23)
            total = np.float32(0)
            for slot in range(known):
                total += kernel[slot] * power[slot]
            density[x] = norm[width_index] * total / np.float32(known)
        row_log(density, logs)
        for x in range(width):
            if needed[y, x] and count[y, x] > 0:
                result[y, x] = logs[x]
