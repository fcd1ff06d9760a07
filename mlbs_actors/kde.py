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
from numpy.polynomial import Chebyshev, Polynomial

from mlbs_actors.appearance import SPREAD_STEP, AppearanceModel, warp_model
from mlbs_actors.compilation import compiled
from mlbs_actors.image_rows import padded_planes, read_row
from mlbs_actors.messages import Array, Region
from mlbs_actors.row_log import row_log

__all__ = [
    "AppearanceParameters",
    "confidence",
    "density_tables",
    "log_densities",
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
    log_densities(
        model.samples,
        model.count,
        model.spread,
        model.residual,
        np.ascontiguousarray(image),
        needed,
        np.float32(parameters.bandwidth_floor),
        np.float32(parameters.registration),
        *density_tables(parameters),
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
def density_tables(parameters: AppearanceParameters) -> tuple[Array, Array]:
    """Log to base 2 of a kernel per squared grey level, and (σ√2π)⁻³, for the 256 values of ``spread``."""
    bandwidth = np.maximum(np.arange(256) * SPREAD_STEP, parameters.bandwidth_floor)
    exponent = (-1.0 / (2.0 * np.log(2.0) * bandwidth**2)).astype(np.float32)
    return exponent, ((bandwidth * np.sqrt(2.0 * np.pi)) ** -3).astype(np.float32)


@compiled()
def _least_spreads(
    planes: Array, y: int, floor: np.float32, registration: np.float32, steepest: Array, least: Array
) -> None:
    """Least bandwidths of a row for the registration error, (w,) in units of ``SPREAD_STEP``.

    Slopes are Sobel's, of the image mirrored at its border; in each direction that of the steepest channel,
    for which ``steepest`` (2, w) has room.
    """
    height, width = planes.shape[1] - 2, planes.shape[2] - 2
    above = y - 1 if y > 0 else min(1, height - 1)
    below = y + 1 if y + 1 < height else max(height - 2, 0)
    steepest[:] = 0
    for channel in range(3):
        upper, middle, lower = planes[channel, above + 1], planes[channel, y + 1], planes[channel, below + 1]
        for x in range(1, width - 1):  # without a branch: this runs in vector registers
            across, down = _slopes(upper, middle, lower, x, x - 1, x + 1)
            steepest[0, x], steepest[1, x] = max(steepest[0, x], across), max(steepest[1, x], down)
        for x in (0, width - 1):
            left, right = x - 1 if x > 0 else min(1, width - 1), x + 1 if x + 1 < width else max(width - 2, 0)
            across, down = _slopes(upper, middle, lower, x, left, right)
            steepest[0, x], steepest[1, x] = max(steepest[0, x], across), max(steepest[1, x], down)
    for x in range(width):
        across, down = steepest[0, x], steepest[1, x]
        squared = np.float32(across * across + down * down) / np.float32(64)
        spread = np.sqrt(floor * floor + registration * registration * squared) / np.float32(SPREAD_STEP)
        least[x] = np.int32(min(np.rint(spread), np.float32(255)))


@compiled(inline="always")
def _slopes(
    upper: Array, middle: Array, lower: Array, x: int, left: int, right: int
) -> tuple[np.int32, np.int32]:
    """Absolute slopes across and down of padded rows."""
    here, before, after = np.uint64(x + 1), np.uint64(left + 1), np.uint64(right + 1)
    top_left, top_right = np.int32(upper[before]), np.int32(upper[after])
    low_left, low_right = np.int32(lower[before]), np.int32(lower[after])
    across = np.int32(middle[after]) - np.int32(middle[before])
    down = np.int32(lower[here]) - np.int32(upper[here])
    return (
        abs(np.int32(top_right - top_left + low_right - low_left + 2 * across)),
        abs(np.int32(low_left - top_left + low_right - top_right + 2 * down)),
    )


@compiled()
def log_densities(
    samples: Array, count: Array, spread: Array, residual: Array, image: Array, needed: Array,
    floor: np.float32, registration: np.float32, exponent: Array, norm: Array, result: Array,
) -> None:  # fmt: skip
    """:func:`log_likelihood` into NaNs, with the model's arrays and :func:`density_tables`."""
    width, slots, stacks = result.shape[1], samples.shape[3], samples.reshape(-1)
    lanes = -(-slots // 4) * 4  # slots of a pixel among the kernels, of which four are summed at once
    planes, colours = padded_planes(image), np.empty((3, width), np.float32)
    steepest, bandwidth = np.empty((2, width), np.int32), np.empty(width, np.int32)
    asked = np.empty(width, np.int32)
    # A float's bits hold its exponent, so 2^n is an integer's shift. All slots of a row, valid or not, and
    # loops of nothing but arithmetic: these run in vector registers.
    kernels, bits = np.zeros(width * lanes, np.float32), np.empty(width * lanes, np.int32)
    powers = bits.view(np.float32)
    density, logs = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(result.shape[0]):
        found = 0
        for x in range(width):
            asked[found] = x  # kept if it counts: a branch would be mispredicted
            found += int(needed[y, x] and count[y, x] > 0)
        if found == 0:
            continue
        read_row(planes, y, residual[y], colours)
        if registration > 0:
            _least_spreads(planes, y, floor, registration, steepest, bandwidth)
        else:
            bandwidth[:] = 0
        for pixel in range(found):
            x = asked[pixel]
            bandwidth[x] = max(bandwidth[x], np.int32(spread[y, x]))
            scale = exponent[bandwidth[x]]
            blue, green, red = colours[0, x], colours[1, x], colours[2, x]
            blues = np.uint64((y * width + x) * 3 * slots)
            greens, reds = blues + np.uint64(slots), blues + np.uint64(2 * slots)
            first = np.uint64(pixel * lanes)
            for number in range(slots):
                place = np.uint64(number)
                off_blue = np.float32(stacks[blues + place]) - blue
                off_green = np.float32(stacks[greens + place]) - green
                off_red = np.float32(stacks[reds + place]) - red
                squared = off_blue * off_blue + off_green * off_green + off_red * off_red
                kernels[first + place] = max(squared * scale, _LEAST)
        for i in range(found * lanes):
            bits[i] = np.int32(kernels[i])
        for i in range(found * lanes):
            z = kernels[i] - np.float32(bits[i])
            kernels[i] = _P0 + z * (_P1 + z * (_P2 + z * (_P3 + z * _P4)))
        for i in range(found * lanes):
            bits[i] = (bits[i] + np.int32(127)) << np.int32(23)
        for i in range(found * lanes):
            kernels[i] *= powers[i]
        for pixel in range(found):
            x = asked[pixel]
            known, own = int(count[y, x]), kernels[pixel * lanes : (pixel + 1) * lanes]
            own[known:] = 0
            one, two, three, four = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for slot in range(0, lanes, 4):
                one, two = one + own[slot], two + own[slot + 1]
                three, four = three + own[slot + 2], four + own[slot + 3]
            density[pixel] = norm[bandwidth[x]] * ((one + two) + (three + four)) / np.float32(known)
        row_log(density[:found], logs[:found])
        for pixel in range(found):
            result[y, asked[pixel]] = logs[pixel]
