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
read from a table, less than 0.004 nats from exact up to q = 40; a kernel is never below e⁻⁴⁰.
"""

from __future__ import annotations

from dataclasses import dataclass

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

#: Entries of the exponential's table a nat.
_TABLE_STEPS = 128
#: exp(−q) for q = 0 … 40 nats; larger exponents are cut off.
_EXP = np.exp(-np.arange(40 * _TABLE_STEPS + 1) / _TABLE_STEPS).astype(np.float32)


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
        np.float32(parameters.registration_px),
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


def _tables(parameters: AppearanceParameters) -> tuple[Array, Array, Array]:
    """Table steps per squared grey level and (σ√2π)⁻³ for the 256 values of ``spread``; window weights."""
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, parameters.bandwidth_floor)
    inverse = (_TABLE_STEPS / (2.0 * bandwidth**2)).astype(np.float32)
    norm = ((bandwidth * np.sqrt(2.0 * np.pi)) ** -3).astype(np.float32)
    offset = np.arange(-parameters.window_radius, parameters.window_radius + 1)
    profile = np.exp(-(offset**2) / (2.0 * parameters.window_std**2))
    return inverse, norm, np.outer(profile, profile).astype(np.float32)


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
    floor: np.float32, registration: np.float32, inverse: Array, norm: Array, weights: Array, result: Array,
) -> None:  # fmt: skip
    height, width, radius = result.shape[0], result.shape[1], weights.shape[0] // 2
    half, last = np.float32(0.5), np.float32(_EXP.size - 1)
    steps = np.empty(samples.shape[3], np.int32)
    for y in range(height):
        for x in range(width):
            if not needed[y, x] or count[y, x] == 0:
                continue
            blue, green, red = read_image(image, y, x, residual[y, x, 0], residual[y, x, 1])
            density, weight = np.float32(0), np.float32(0)
            for row in range(max(y - radius, 0), min(y + radius + 1, height)):
                for column in range(max(x - radius, 0), min(x + radius + 1, width)):
                    known = int(count[row, column])
                    if known == 0:
                        continue
                    width_index = int(spread[row, column])
                    if registration > 0:
                        least = _least_spread(image, row, column, floor, registration)
                        width_index = max(width_index, least)
                    # All slots, valid or not, and nothing but arithmetic: this runs in vector registers.
                    scale = inverse[width_index]
                    for slot in range(steps.size):
                        d_blue = np.float32(samples[row, column, 0, slot]) - blue
                        d_green = np.float32(samples[row, column, 1, slot]) - green
                        d_red = np.float32(samples[row, column, 2, slot]) - red
                        exponent = (d_blue * d_blue + d_green * d_green + d_red * d_red) * scale
                        steps[slot] = np.int32(min(exponent, last) + half)
                    kernels = np.float32(0)
                    for slot in range(known):
                        kernels += _EXP[steps[slot]]
                    share = weights[row - y + radius, column - x + radius]
                    density += share * norm[width_index] * kernels / np.float32(known)
                    weight += share
            result[y, x] = np.log(density / weight)
