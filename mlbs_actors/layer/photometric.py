"""Which motion explains the image better: an object's own, or the camera's.

Not in the paper. Both motions move the last frame into the new one; their errors are compared over a small
window. In smooth places both explain the image, and the term is 0; on texture the right one wins, which
recovers ground that was once attributed to an object, and holds an object together between its trajectories.

Either motion is trusted only where it explains the image well in itself: a limb obeys neither. An object's
own is also trusted only where it leads back to pixels that were the object's: ground that it has just
uncovered has no past that could explain it, but over smooth ground any motion seems to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.config import PosteriorConfig
from mlbs_actors.geometry.homography import homography_of_cells
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["PhotometricRules", "photometric_advantage"]

#: Position (x, y) of an image's corner in the frame.
Corner = tuple[int, int]
#: Side of the window over which motions are compared.
WINDOW = 3


class PhotometricRules(NamedTuple):
    """Parameters of how far a motion is trusted.

    Attributes
    ----------
    largest : float32
        Bound of the advantage in either direction, × noise.
    least_noise, most_noise : float32
        Bounds of the noise estimate, grey levels: lower than those of the camera's evidence, as the means of
        cells are less noisy.
    own, camera : float32
        Error at which a motion is not trusted at all, × noise; from one less on it is trusted fully.
    """

    largest: np.float32
    least_noise: np.float32
    most_noise: np.float32
    own: np.float32
    camera: np.float32

    @staticmethod
    def configured(config: PosteriorConfig) -> PhotometricRules:
        """Return the rules of a configuration."""
        noise = config.photometric_least_noise, config.photometric_most_noise
        rules = config.photometric_cap, *noise, config.own_believed, config.camera_believed
        return PhotometricRules(*map(np.float32, rules))


@compiled
def photometric_advantage(
    before: Array, now: Array, motion: Array, camera: Array, side: int, corners: tuple[Corner, Corner],
    own: Array, rules: PhotometricRules,
) -> Array:  # fmt: skip
    """Measure by how much an object's motion explains the image better than the camera's.

    Parameters
    ----------
    before, now : (last h, last w, 3), (h, w, 3) uint8
        Its regions of frames t−1 and t, BGR.
    motion : (h, w, 2) float32
        The object's backward motion at the pixels of ``now``, in these.
    camera : (3, 3) float64
        The camera's: takes px of frame t to frame t−1.
    side : int
        Of the pixels of both, px of the frame.
    corners : two (x, y)
        Where ``now`` and ``before`` begin in the frame, in their pixels.
    own : (h, w) bool
        Where the object's motion leads back to its own pixels.
    rules : PhotometricRules

    Returns
    -------
    (h, w) float32
        In units of the noise, which is the median error of the camera's motion, within bounds; 0 where
        either motion leads out of ``before``.
    """
    if before.size == 0 or now.size == 0:
        return np.zeros(own.shape, np.float32)
    # A border of zeros stands for the outside, one pixel wider below and on the right for interpolation.
    last = np.zeros((before.shape[0] + 3, before.shape[1] + 3), np.uint8)
    newest = np.empty(now.shape[:2], np.uint8)
    _write_grey(before, last, 1)
    _write_grey(now, newest, 0)
    known = np.empty(newest.shape, np.bool_)
    own_misfit, camera_misfit = _misfits(
        last, newest, motion, homography_of_cells(camera, side), corners, known
    )
    own_sums, camera_sums = _window_sums(own_misfit), _window_sums(camera_misfit)
    return _compared(own_sums, camera_sums, _noise(camera_sums, rules), own, known, rules)


@compiled
def _write_grey(image: Array, grey: Array, border: int) -> None:
    """Write the brightness of BGR pixels, rounded as cv2 does, into an image with a border above and left."""
    colours = image.reshape(-1)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            pixel, one, two = np.uint64(3 * (y * image.shape[1] + x)), np.uint64(1), np.uint64(2)
            blue, green, red = colours[pixel], colours[pixel + one], colours[pixel + two]
            weighed = np.int32(3735) * blue + np.int32(19235) * green + np.int32(9798) * red
            grey[y + border, x + border] = np.uint8((np.int32(weighed) + np.int32(1 << 14)) >> np.int32(15))


@compiled  # where the camera's horizon lies in the frame, a depth can be 0
def _misfits(
    last: Array,
    newest: Array,
    motion: Array,
    camera: Array,
    corners: tuple[Corner, Corner],
    known: Array,
) -> tuple[Array, Array]:
    """Compute each pixel's difference from its source under either motion, and whether both are known."""
    corner, last_corner = corners
    height, width = newest.shape
    bottom, right = last.shape[0] - 4, last.shape[1] - 4
    # In one row each: the step to the next short row takes as long as the row itself.
    sources, moves = np.empty((4, newest.size), np.float32), motion.reshape(-1)
    own_x, own_y, camera_x, camera_y = sources[0], sources[1], sources[2], sources[3]
    inside, cells = known.reshape(-1), newest.reshape(-1)
    for v in range(height):
        y = np.float64(v + corner[1])
        for u in range(width):
            place, x = np.uint64(v * width + u), np.float64(u + corner[0])
            depth = camera[2, 0] * x + camera[2, 1] * y + camera[2, 2]
            x_own = x + moves[np.uint64(2) * place] - last_corner[0]
            y_own = y + moves[np.uint64(2) * place + np.uint64(1)] - last_corner[1]
            x_camera = (camera[0, 0] * x + camera[0, 1] * y + camera[0, 2]) / depth - last_corner[0]
            y_camera = (camera[1, 0] * x + camera[1, 1] * y + camera[1, 2]) / depth - last_corner[1]
            own_x[place], own_y[place], camera_x[place], camera_y[place] = x_own, y_own, x_camera, y_camera
            inside[place] = (
                (x_own >= 0) & (x_own <= right) & (y_own >= 0) & (y_own <= bottom)
                & (x_camera >= 0) & (x_camera <= right) & (y_camera >= 0) & (y_camera <= bottom)
            )  # fmt: skip
    quads = _quads(last)
    own_misfit, camera_misfit = _misfit(quads, cells, own_x, own_y), _misfit(quads, cells, camera_x, camera_y)
    return own_misfit.reshape(newest.shape), camera_misfit.reshape(newest.shape)


@compiled
def _quads(image: Array) -> Array:
    """Pack what a pixel's interpolation needs: its byte and those of the pixels right, below and both."""
    quads, shift = np.zeros(image.shape, np.uint32), np.uint32(8)
    for y in range(image.shape[0] - 1):
        row, below, result = image[y], image[y + 1], quads[y]
        for x in range(image.shape[1] - 1):
            place, right = np.uint64(x), np.uint64(x + 1)
            pair, lower = np.uint32(row[right]) << shift, np.uint32(below[right]) << shift
            pair, lower = pair | np.uint32(row[place]), lower | np.uint32(below[place])
            result[place] = pair | (lower << np.uint32(16))
    return quads


@compiled
def _misfit(quads: Array, newest: Array, source_x: Array, source_y: Array) -> Array:
    """Difference pixels and their sources in the bordered last image, interpolated bilinearly.

    The sources are reduced to their fractions.
    """
    flat, stride, byte = quads.reshape(-1), np.int32(quads.shape[1]), np.int32(255)
    outside, right, bottom = np.float32(-1), np.float32(quads.shape[1] - 3), np.float32(quads.shape[0] - 3)
    around, misfit = np.empty(newest.size, np.int32), np.empty(newest.size, np.int32)
    # Loops without a branch are vectorised: a source outside the image is clamped to its border.
    for i in range(newest.size):
        x = min(source_x[i], right) if source_x[i] > outside else outside
        y = min(source_y[i], bottom) if source_y[i] > outside else outside
        left, top = np.floor(x), np.floor(y)
        source_x[i], source_y[i] = x - left, y - top
        around[i] = (np.int32(top) + np.int32(1)) * stride + np.int32(left) + np.int32(1)
    for i in range(newest.size):
        place = np.uint64(i)
        around[place] = np.int32(flat[np.uint64(np.uint32(around[place]))])
    for i in range(newest.size):
        along, down, quad = source_x[i], source_y[i], around[i]
        a, b = np.float32(quad & byte), np.float32((quad >> np.int32(8)) & byte)
        c, d = np.float32((quad >> np.int32(16)) & byte), np.float32((quad >> np.int32(24)) & byte)
        above, below = a + along * (b - a), c + along * (d - c)
        moved = np.rint(above + down * (below - above))
        misfit[i] = abs(np.int32(newest[i]) - np.int32(moved))
    return misfit


@compiled
def _window_sums(values: Array) -> Array:
    """Sum integers over the window, the image mirrored at its border."""
    height, width = values.shape
    result, sums = np.empty(values.shape, np.int32), np.empty(width + 2, np.int32)
    inner = sums[1:-1]
    for y in range(height):
        above = values[y - 1 if y > 0 else min(1, height - 1)]
        below = values[y + 1 if y + 1 < height else max(height - 2, 0)]
        own, row = values[y], result[y]
        for x in range(width):
            inner[x] = above[x] + own[x] + below[x]
        sums[0], sums[width + 1] = inner[min(1, width - 1)], inner[max(width - 2, 0)]
        for x in range(width):
            row[x] = sums[x] + sums[x + 1] + sums[x + 2]
    return result


@compiled
def _noise(sums: Array, rules: PhotometricRules) -> np.float32:
    """Return the median of every fourth window's mean, clipped to the noise's bounds, by a counting sort."""
    top = np.int32(np.ceil(rules.most_noise * WINDOW**2))
    counts, total = np.zeros(top + 1, np.int64), 0
    for y in range(0, sums.shape[0], 2):
        for x in range(0, sums.shape[1], 2):
            counts[min(sums[y, x], top)] += 1
            total += 1
    below, lower, value = 0, -1, 0
    while below <= total // 2:
        below += counts[value]
        if lower < 0 and below > (total - 1) // 2:
            lower = value
        value += 1
    ninth = np.float32(1 / WINDOW**2)
    median: np.float32 = np.float32(0.5) * (np.float32(lower) * ninth + np.float32(value - 1) * ninth)
    return min(max(median, rules.least_noise), rules.most_noise)


@compiled
def _compared(
    own_sums: Array, camera_sums: Array, noise: np.float32, own: Array, known: Array, rules: PhotometricRules
) -> Array:
    zero, one, ninth = np.float32(0), np.float32(1), np.float32(1 / WINDOW**2)
    advantage = np.empty(known.shape, np.float32)
    for y in range(known.shape[0]):  # branch-free, hence vectorised
        own_row, camera_row, row = own_sums[y], camera_sums[y], advantage[y]
        its_own, seen = own[y], known[y]
        for x in range(row.size):
            by_own, by_camera = (
                np.float32(own_row[x]) * ninth / noise,
                np.float32(camera_row[x]) * ninth / noise,
            )
            lead = min(max(by_camera - by_own, -rules.largest), rules.largest)
            own_believed = rules.own - by_own if its_own[x] else zero
            believed = own_believed if lead > zero else rules.camera - by_camera
            row[x] = lead * min(max(believed, zero), one) if seen[x] else zero
    return advantage
