"""Kernel density estimation of the frame's colours under a layer, pixel by pixel (§6.2).

The density of a colour c at a pixel with the samples c_1 … c_n is

    p(c) = 1/n Σ_f Π_ch N(c_ch; c_f,ch, σ²)          nats per unit RGB volume (1/level³) after the log.

**Bandwidth.** σ is one for the three channels of a pixel: the stack's running median of the mean absolute
successive difference, with a floor. (A median |a − b| of two Gaussian values is 0.95 σ; the mean over three
independent channels has its median at 1.1 σ, over three equal ones at 0.95 σ: it is taken as σ.) Where the
image is steep, a slightly misplaced model errs by much: there the floor is √(σ_min² + (e·|∇I|)²),
e the registration error. Without it outlines and textures contradict the model of a rotating object.

**Unknown is not unlikely.** A pixel without samples has no likelihood: NaN, with confidence 0.

Differs from the paper: the sum is divided by the number of samples (the published MATLAB code does not, which
acts as an accidental prior); colours are plain BGR (there: normalised red, green and intensity); exponential
and logarithm are polynomials, together within 1e-3 nats of exact; a kernel is never below e⁻⁴⁰.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from mlbs_actors.appearance.colour_model import SPREAD_STEP, AppearanceModel, warp_model
from mlbs_actors.config import Config
from mlbs_actors.kernels.fast_log import row_log
from mlbs_actors.kernels.image_rows import padded_planes, read_row, row_room
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.kernels.simd import (
    LANES,
    absolute,
    broadcast,
    exp2_of_whole,
    load,
    maximum,
    minimum,
    rounded,
    square_root,
    store,
    sum_of_lanes,
    truncated,
)
from mlbs_actors.messages import Array, LayerKind, Region

__all__ = [
    "AppearanceParameters",
    "confidence",
    "log_likelihood",
    "mean_confidence",
    "warp_and_evaluate",
]

#: Least logarithm of a kernel to base 2.
_LEAST = np.float32(-40.0 / np.log(2.0))
#: From index 16 − n on, the first n lanes are 1.
_VALID = np.repeat(np.array([1, 0], np.float32), LANES)
#: 2^z for −1 ≤ z ≤ 0.
_P0, _P1, _P2, _P3, _P4 = (
    np.float32(one)
    for one in Chebyshev.interpolate(np.exp2, 4, domain=[-1.0, 0.0]).convert(kind=Polynomial).coef
)


@dataclass(frozen=True, slots=True)
class AppearanceParameters:
    """Parameters of the density estimate.

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

    @classmethod
    def configured(cls, config: Config, kind: LayerKind, side: int) -> AppearanceParameters:
        """Take the parameters of a kind of layer from a configuration, for images of cells of ``side`` px."""
        colours, background = config.appearance, kind == "background"
        registration = colours.background_registration_px if background else colours.registration_px
        return cls(colours.bandwidth_floor, registration / side, colours.half_confidence_samples)


def confidence(count: Array, parameters: AppearanceParameters) -> Array:
    """Return the trust in stacks of ``count`` samples: n / (n + n_half), in [0, 1), float32."""
    samples = count.astype(np.float32)
    trust: Array = samples / (samples + np.float32(parameters.half_confidence_samples))
    return trust


def mean_confidence(count: Array, parameters: AppearanceParameters) -> float:
    """Average :func:`confidence` over a model's stacks; 0 for an empty model."""
    return float(_mean_of_table(count, confidence(np.arange(256), parameters)))


@compiled
def _mean_of_table(places: Array, table: Array) -> float:
    total = 0.0
    for y in range(places.shape[0]):
        for x in range(places.shape[1]):
            total += table[places[y, x]]
    return total / max(places.size, 1)


def log_likelihood(
    model: AppearanceModel, image: Array, parameters: AppearanceParameters, needed: Array | None = None
) -> Array:
    """Evaluate the log density of the frame's colours under a model of the same frame.

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
    needed = np.ones(model.count.shape, np.bool_) if needed is None else needed
    bandwidths = np.float32(parameters.bandwidth_floor), np.float32(parameters.registration)
    log_density: Array = _log_densities(
        model.arrays, np.ascontiguousarray(image), needed, bandwidths, _density_tables(parameters)
    )
    return log_density


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
def _density_tables(parameters: AppearanceParameters) -> tuple[Array, Array]:
    """Tabulate log₂ of a kernel per squared grey level, and (σ√2π)⁻³, for the 256 values of ``spread``."""
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, parameters.bandwidth_floor)
    exponent = (-1.0 / (2.0 * np.log(2.0) * bandwidth**2)).astype(np.float32)
    return exponent, ((bandwidth * np.sqrt(2.0 * np.pi)) ** -3).astype(np.float32)


@compiled
def _least_spreads(
    planes: Array, y: int, first: int, end: int, floor: np.float32, registration: np.float32, least: Array
) -> None:
    """Compute the least bandwidths for the registration error in a part of a row, × ``SPREAD_STEP``.

    Gradients are Sobel's, of the image mirrored at its border; in each direction that of the steepest
    channel. ``least`` is padded to whole registers.
    """
    height, width = planes.shape[1] - 2, planes.shape[2] - 2
    above = y - 1 if y > 0 else min(1, height - 1)
    below = y + 1 if y + 1 < height else max(height - 2, 0)
    flat, row, one, two = planes.reshape(-1), np.uint64(planes.shape[2]), np.uint64(1), np.uint64(2)
    for start in range(first // LANES * LANES, end, LANES):
        across, down = broadcast(np.float32(0), LANES), broadcast(np.float32(0), LANES)
        for channel in range(3):
            place = np.uint64(channel * (height + 2)) * row + np.uint64(start)
            upper, middle = place + np.uint64(above + 1) * row, place + np.uint64(y + 1) * row
            lower = place + np.uint64(below + 1) * row
            top_left, top_right = load(flat, upper, LANES), load(flat, upper + two, LANES)
            low_left, low_right = load(flat, lower, LANES), load(flat, lower + two, LANES)
            level = load(flat, middle + two, LANES) - load(flat, middle, LANES)
            upright = load(flat, lower + one, LANES) - load(flat, upper + one, LANES)
            across = maximum(across, absolute(top_right - top_left + low_right - low_left + level + level))
            down = maximum(down, absolute(low_left - top_left + low_right - top_right + upright + upright))
        store(least, np.uint64(start), across * across + down * down)
    for x in (0, width - 1):
        left, right = x - 1 if x > 0 else min(1, width - 1), x + 1 if x + 1 < width else max(width - 2, 0)
        squared = _squared_slope(planes, above, y, below, x, left, right)
        least[x] = squared if first <= x < end else least[x]
    for start in range(first // LANES * LANES, end, LANES):
        x = np.uint64(start)
        slope = broadcast(registration * registration, LANES) * (
            load(least, x, LANES) / broadcast(np.float32(64), LANES)
        )
        width_of = square_root(broadcast(floor * floor, LANES) + slope) / broadcast(
            np.float32(SPREAD_STEP), LANES
        )
        store(least, x, minimum(rounded(width_of), broadcast(np.float32(255), LANES)))


@compiled
def _squared_slope(
    planes: Array, above: int, y: int, below: int, x: int, left: int, right: int
) -> np.float32:
    """Return the squared gradient of a pixel from these rows and columns around it."""
    across, down = np.int32(0), np.int32(0)
    for channel in range(3):
        upper, middle, lower = planes[channel, above + 1], planes[channel, y + 1], planes[channel, below + 1]
        top_left, top_right = np.int32(upper[left + 1]), np.int32(upper[right + 1])
        low_left, low_right = np.int32(lower[left + 1]), np.int32(lower[right + 1])
        level = np.int32(middle[right + 1]) - np.int32(middle[left + 1])
        upright = np.int32(lower[x + 1]) - np.int32(upper[x + 1])
        across = max(across, abs(top_right - top_left + low_right - low_left + 2 * level))
        down = max(down, abs(low_left - top_left + low_right - top_right + 2 * upright))
    return np.float32(across * across + down * down)


@compiled
def _log_densities(
    model: tuple[Array, Array, Array, Array, Array], image: Array, needed: Array,
    bandwidths: tuple[np.float32, np.float32], tables: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Evaluate :func:`log_likelihood` with the model's arrays and :func:`_density_tables`."""
    samples, count, _, spread, residual = model
    floor, registration = bandwidths
    exponent, norm = tables
    result = np.full(count.shape, np.float32(np.nan), np.float32)
    height, width = count.shape
    slots = samples.shape[3]
    whole = -(-slots // LANES) * LANES
    stacks, stack = samples.reshape(-1), np.empty(3 * whole, np.uint8)
    planes, colours = padded_planes(image), row_room(width)
    least, asked = np.zeros(colours.shape[1], np.float32), np.empty(width, np.int64)
    density, places, evaluated = np.empty(result.size, np.float32), np.empty(result.size, np.int64), 0
    for y in range(height):
        found = 0
        for x in range(width):
            asked[found] = x  # kept if it counts; a branch would be mispredicted
            found += int(needed[y, x] & (count[y, x] > 0))
        if found == 0:
            continue
        first, end = asked[0], asked[found - 1] + 1
        read_row(planes, y, residual, first, end, colours)
        if registration > 0:
            _least_spreads(planes, y, first, end, floor, registration, least)
        for pixel in range(found):
            cell = np.uint64(asked[pixel])
            bandwidth = np.uint64(max(np.int32(least[cell]), np.int32(spread[y, cell])))
            scale, number, place = exponent[bandwidth], np.int64(count[y, cell]), y * width + np.int64(cell)
            blue, green, red = colours[0, cell], colours[1, cell], colours[2, cell]
            if slots == whole:
                at = np.uint64(3 * slots * place)
                kernels = _sum_of_kernels(stacks, at, whole, blue, green, red, scale, number)
            else:
                for channel in range(3):
                    stack[channel * whole : channel * whole + slots] = samples[y, cell, channel]
                kernels = _sum_of_kernels(stack, np.uint64(0), whole, blue, green, red, scale, number)
            density[evaluated], places[evaluated] = norm[bandwidth] * kernels / np.float32(number), place
            evaluated += 1
    logs, results = np.empty(evaluated, np.float32), result.reshape(-1)
    row_log(density[:evaluated], logs)
    for pixel in range(evaluated):
        results[np.uint64(places[pixel])] = logs[pixel]
    return result


@compiled
def _sum_of_kernels(
    stacks: Array, at: np.uint64, slots: int, blue: np.float32, green: np.float32, red: np.float32,
    scale: np.float32, known: np.int64,
) -> np.float32:  # fmt: skip
    """Sum the kernels of a colour over the first samples of a stack with this many slots a channel."""
    sums = broadcast(np.float32(0), LANES)
    for first in range(0, slots, LANES):
        blues = at + np.uint64(first)
        greens, reds = blues + np.uint64(slots), blues + np.uint64(2 * slots)
        off_blue = load(stacks, blues, LANES) - broadcast(blue, LANES)
        off_green = load(stacks, greens, LANES) - broadcast(green, LANES)
        off_red = load(stacks, reds, LANES) - broadcast(red, LANES)
        squared = off_blue * off_blue + off_green * off_green + off_red * off_red
        exponent = maximum(squared * broadcast(scale, LANES), broadcast(_LEAST, LANES))
        whole = truncated(exponent)
        z = exponent - whole
        power = broadcast(_P3, LANES) + z * broadcast(_P4, LANES)
        power = broadcast(_P1, LANES) + z * (broadcast(_P2, LANES) + z * power)
        power = (broadcast(_P0, LANES) + z * power) * exp2_of_whole(whole)
        missing = min(max(np.int64(LANES + first) - known, np.int64(0)), np.int64(LANES))
        sums = sums + power * load(_VALID, np.uint64(missing), LANES)
    together: np.float32 = sum_of_lanes(sums)
    return together
