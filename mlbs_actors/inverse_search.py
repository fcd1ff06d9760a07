"""Dense inverse search: the motion of small patches, coarse to fine (Kroeger et al., ECCV 2016).

On every level patches on a grid start from the flow that is known so far or from that of a neighbour,
whichever explains the image better, and descend from there. Each pixel then takes the mean motion of the
patches over it, those that explain it well counting most, and a variational refinement
(:mod:`mlbs_actors.variational_refinement`) smooths the result.

OpenCV has it whole, too. Here it takes half of the time: a frame's levels are made once for
both directions, and the kernels fill the registers. A part of a level is searched in sight of what lies
around it, which makes better flow than a frame cut to the part.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array, Region
from mlbs_actors.variational_refinement import refine_flow

__all__ = [
    "PATCH",
    "FlowLevel",
    "SearchEffort",
    "coarsest_level",
    "flow_levels",
    "improve_flow",
    "resized_flow",
]

#: Side of a patch, px.
PATCH = 8
#: Pixels by which a frame is continued past its sides: a patch may leave it altogether.
MARGIN = 16
#: Grey levels are counted in sixteenths: sums of squares over a patch still fit into 32 bits.
SHADES = 16
#: Sweeps of the variational refinement's solver: more make no flow that is told apart better.
SWEEPS = 3


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """How much is done for a flow.

    Attributes
    ----------
    iterations : int
        Descents of a patch at most, half of them in each of two passes over the level.
    refinements : int
        Iterations of the variational refinement; 0 = none.
    stride : int
        From one patch to the next, px.
    """

    iterations: int
    refinements: int
    stride: int


@dataclass(frozen=True, slots=True)
class FlowLevel:
    """One level of a frame.

    Attributes
    ----------
    gray : (h, w) uint8
    shades : (h, w) int32
        The same × ``SHADES``.
    around : (h + 2 MARGIN, w + 2 MARGIN) float32
        The same, continued past its sides.
    slope_x, slope_y : (h, w) int16
        Sobel gradients.
    """

    gray: Array
    shades: Array
    around: Array
    slope_x: Array
    slope_y: Array


def coarsest_level(shape: tuple[int, int]) -> int:
    """Number of halvings after which a frame (h, w) is about four patches wide, and at least one high."""
    return max(0, min(int(np.log2(max(shape) / (4.0 * PATCH)) + 0.5), int(np.log2(min(shape) / PATCH))))


def flow_levels(gray: Array, count: int) -> list[FlowLevel]:
    """A frame (h, w) uint8 and its next ``count`` halvings, finest first."""
    levels = []
    for level in range(count + 1):
        if level:
            gray = cv2.resize(gray, (gray.shape[1] // 2, gray.shape[0] // 2), interpolation=cv2.INTER_AREA)
        shades = gray * np.int32(SHADES)
        around = cv2.copyMakeBorder(
            shades.astype(np.float32), MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE
        )
        levels.append(FlowLevel(gray, shades, around, *cv2.spatialGradient(gray)))
    return levels


def resized_flow(flow: Array, shape: tuple[int, int]) -> Array:
    """Flow planes (2, h, w) on a grid of another size, in px of that; the same array if it has that size."""
    _, height, width = flow.shape
    if shape == (height, width):
        return flow
    resized = np.empty((2, *shape), np.float32)
    for one, wider, factor in zip(flow, resized, (shape[1] / width, shape[0] / height), strict=True):
        cv2.resize(one, shape[::-1], dst=wider)
        wider *= np.float32(factor)
    return resized


def improve_flow(
    source: FlowLevel, target: FlowLevel, flow: Array, part: Region, effort: SearchEffort
) -> None:
    """Search a part of a level, and refine what is found there.

    Parameters
    ----------
    source, target : FlowLevel
        Alike in size.
    flow : (2, h, w) float32
        x and y of the motion from ``source`` to ``target`` as it is known so far, px; improved in place.
    part : Region
        At least a patch wide and high.
    effort : SearchEffort
    """
    across = _patch_places(part.x, part.width, effort.stride)
    down = _patch_places(part.y, part.height, effort.stride)
    motions = _search(
        source.shades, target.around, source.slope_x, source.slope_y, flow, across, down,
        max(1, effort.iterations // 2),
    )  # fmt: skip
    window = np.zeros((3, part.height, part.width), np.float32)
    _densify(source.shades, target.around, motions, across, down, part.x, part.y, window)
    for _ in range(effort.refinements):
        refine_flow(source.shades, target.around, part.x, part.y, window, MARGIN, SHADES, SWEEPS)
    for known, found in zip(flow, window, strict=False):  # the last of the window is the sum of weights
        known[part.slices] = found


def _patch_places(start: int, length: int, stride: int) -> Array:
    """Where patches begin along one axis: the last one ends where the part does."""
    last = start + length - PATCH
    return np.minimum(np.arange(start, last + stride, stride), last)


@compiled()
def _search(
    shades: Array, around: Array, slope_x: Array, slope_y: Array, flow: Array, across: Array, down: Array,
    iterations: int,
) -> Array:  # fmt: skip
    """Motion of each patch, (rows, columns, 2), in two passes: from the top left, and back."""
    rows, columns = down.size, across.size
    motions = np.empty((rows, columns, 2), np.float32)
    centre, farthest = PATCH // 2, np.float32(PATCH * PATCH)
    for turn in range(2):
        step = 1 - 2 * turn
        for place in range(rows * columns):
            row, column = divmod(place if turn == 0 else rows * columns - 1 - place, columns)
            y, x = down[row], across[column]
            if turn == 0:
                motions[row, column, 0] = flow[0, y + centre, x + centre]
                motions[row, column, 1] = flow[1, y + centre, x + centre]
            u, v = motions[row, column, 0], motions[row, column, 1]
            least = _mismatch(shades, around, y, x, u, v)
            for other_row, other_column in ((row, column - step), (row - step, column)):
                if 0 <= other_row < rows and 0 <= other_column < columns:
                    other_u, other_v = (
                        motions[other_row, other_column, 0],
                        motions[other_row, other_column, 1],
                    )
                    other = _mismatch(shades, around, y, x, other_u, other_v)
                    if other < least:
                        least, u, v = other, other_u, other_v
            found_u, found_v = _descend(shades, around, slope_x, slope_y, y, x, u, v, iterations)
            # What ends far from where it began has lost its way.
            if (found_u - u) ** 2 + (found_v - v) ** 2 <= farthest:
                u, v = found_u, found_v
            motions[row, column, 0], motions[row, column, 1] = u, v
    return motions


@compiled()
def _descend(
    shades: Array, around: Array, slope_x: Array, slope_y: Array, y: int, x: int, u: np.float32,
    v: np.float32, iterations: int,
) -> tuple[np.float32, np.float32]:  # fmt: skip
    """Inverse-compositional descent of a patch, brightness aside, until the image is explained no better.

    Sobel's slopes are eight times the derivatives, so that a step is an eighth of Gauss and Newton's. With
    whole ones more patches lose their way.
    """
    xx, xy, yy, sum_x, sum_y = _slopes(slope_x, slope_y, y, x)
    determinant = max(xx * yy - xy * xy, np.float32(1e-3))
    before = np.float32(np.inf)
    for _ in range(iterations):
        total, squares, along, below = _differences(shades, around, slope_x, slope_y, y, x, u, v)
        mean = np.float32(total) / np.float32(PATCH * PATCH)
        gradient_x = (np.float32(along) - mean * sum_x) / np.float32(SHADES)
        gradient_y = (np.float32(below) - mean * sum_y) / np.float32(SHADES)
        u -= (yy * gradient_x - xy * gradient_y) / determinant
        v -= (xx * gradient_y - xy * gradient_x) / determinant
        mismatch = np.float32(squares) - mean * np.float32(total)
        if mismatch >= before:
            break
        before = mismatch
    return u, v


@compiled()
def _slopes(
    slope_x: Array, slope_y: Array, y: int, x: int
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Sums over a patch: of the slopes' squares and product, and of the slopes."""
    xx, xy, yy, sum_x, sum_y = np.int32(0), np.int32(0), np.int32(0), np.int32(0), np.int32(0)
    top, left = np.uintp(y), np.uintp(x)
    for column in range(PATCH):
        for row in range(PATCH):
            at_y, at_x = top + np.uintp(row), left + np.uintp(column)
            along, below = np.int32(slope_x[at_y, at_x]), np.int32(slope_y[at_y, at_x])
            xx, xy, yy = (
                np.int32(xx + along * along),
                np.int32(xy + along * below),
                np.int32(yy + below * below),
            )
            sum_x, sum_y = np.int32(sum_x + along), np.int32(sum_y + below)
    return np.float32(xx), np.float32(xy), np.float32(yy), np.float32(sum_x), np.float32(sum_y)


@compiled()
def _source_place(
    around: Array, y: int, x: int, u: np.float32, v: np.float32
) -> tuple[np.uintp, np.uintp, np.float32, np.float32, np.float32, np.float32]:
    """Where a moved patch begins in the continued frame, and the weights of a pixel's four neighbours."""
    least = np.float32(MARGIN - PATCH + 1)
    bottom = np.float32(around.shape[0] - MARGIN - 1)
    right = np.float32(around.shape[1] - MARGIN - 1)
    at_y = min(max(np.float32(y + MARGIN) + v, least), bottom)
    at_x = min(max(np.float32(x + MARGIN) + u, least), right)
    top, left = np.uintp(at_y), np.uintp(at_x)
    down, across = at_y - np.float32(top), at_x - np.float32(left)
    up, back = np.float32(1) - down, np.float32(1) - across
    return top, left, up * back, up * across, down * back, down * across


@compiled(inline="always")
def _moved(
    around: Array,
    there_y: np.uintp,
    there_x: np.uintp,
    row: int,
    column: int,
    w00: np.float32,
    w01: np.float32,
    w10: np.float32,
    w11: np.float32,
) -> np.float32:
    """What the continued frame shows at a pixel of a moved patch, by :func:`_source_place`."""
    upper, lower = there_y + np.uintp(row), there_y + np.uintp(row + 1)
    near, far = there_x + np.uintp(column), there_x + np.uintp(column + 1)
    moved: np.float32 = w00 * around[upper, near] + w01 * around[upper, far]
    moved += w10 * around[lower, near] + w11 * around[lower, far]
    return moved


# The loops over a patch go over columns outside: LLVM unrolls the rows, and does all columns at once. Sums
# are of whole numbers, which may be added in any order.


@compiled()
def _mismatch(shades: Array, around: Array, y: int, x: int, u: np.float32, v: np.float32) -> np.float32:
    """Sum of squared differences of a patch and its place in the target, but for their mean."""
    there_y, there_x, w00, w01, w10, w11 = _source_place(around, y, x, u, v)
    top, left = np.uintp(y), np.uintp(x)
    total, squares = np.int32(0), np.int32(0)
    for column in range(PATCH):
        for row in range(PATCH):
            moved = _moved(around, there_y, there_x, row, column, w00, w01, w10, w11)
            difference = np.int32(moved) - shades[top + np.uintp(row), left + np.uintp(column)]
            total = np.int32(total + difference)
            squares = np.int32(squares + np.int32(difference * difference))
    mean = np.float32(total) / np.float32(PATCH * PATCH)
    return np.float32(squares) - mean * np.float32(total)


@compiled()
def _differences(
    shades: Array, around: Array, slope_x: Array, slope_y: Array, y: int, x: int, u: np.float32, v: np.float32
) -> tuple[np.int32, np.int32, np.int32, np.int32]:
    """Sums of a patch's differences: plain, squared, times its slope along x, and along y."""
    there_y, there_x, w00, w01, w10, w11 = _source_place(around, y, x, u, v)
    top, left = np.uintp(y), np.uintp(x)
    total, squares, along, below = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
    for column in range(PATCH):
        for row in range(PATCH):
            moved = _moved(around, there_y, there_x, row, column, w00, w01, w10, w11)
            at_y, at_x = top + np.uintp(row), left + np.uintp(column)
            difference = np.int32(moved) - shades[at_y, at_x]
            total = np.int32(total + difference)
            squares = np.int32(squares + np.int32(difference * difference))
            along = np.int32(along + np.int32(difference * np.int32(slope_x[at_y, at_x])))
            below = np.int32(below + np.int32(difference * np.int32(slope_y[at_y, at_x])))
    return total, squares, along, below


@compiled()
def _densify(
    shades: Array,
    around: Array,
    motions: Array,
    across: Array,
    down: Array,
    left: int,
    top: int,
    window: Array,
) -> None:
    """Mean motion of the patches over each pixel, into (3, h, w) zeros: x, y and the sum of weights.

    A patch weighs 1 / its difference there in grey levels, at most 1.
    """
    one = np.float32(1)
    for row in range(down.size):
        for column in range(across.size):
            y, x = down[row], across[column]
            u, v = motions[row, column, 0], motions[row, column, 1]
            there_y, there_x, w00, w01, w10, w11 = _source_place(around, y, x, u, v)
            for j in range(PATCH):
                for i in range(PATCH):
                    moved = _moved(around, there_y, there_x, j, i, w00, w01, w10, w11)
                    difference = moved - np.float32(shades[np.uintp(y + j), np.uintp(x + i)])
                    weight = one / max(one, abs(difference) / np.float32(SHADES))
                    at_y, at_x = np.uintp(y + j - top), np.uintp(x + i - left)
                    window[0, at_y, at_x] += weight * u
                    window[1, at_y, at_x] += weight * v
                    window[2, at_y, at_x] += weight
    for y in range(window.shape[1]):
        for x in range(window.shape[2]):
            window[0, y, x] /= window[2, y, x]
            window[1, y, x] /= window[2, y, x]
