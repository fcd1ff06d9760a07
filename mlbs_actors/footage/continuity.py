"""Whether a picture continues the one before: by how much of it the flow finds again, and in which rows.

Forward and backward flow between two scenes confirm each other almost nowhere, and what they lead to is not
alike: across the cuts of the data that the method is measured on, the share of confirmed flow times that of
the textured places that correlate is 0–0.06, elsewhere at least 0.19. That serves better than histograms or
differences, which fast pans, close passers-by and changes of light move as cuts do.

By the same measures the camera's motion cannot be told where next to nothing is both confirmed and alike: the
noise of a smooth picture is found nowhere again, and waves are, but each by itself.

A torn picture is found by its rows: a band across the whole width that, all at once, no longer moves as the
rest does.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.geometry.homography import homography_motion
from mlbs_actors.kernels.image_rows import mirrored
from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.messages import Array

__all__ = [
    "LEAST_FOUND",
    "SURELY_ALIKE",
    "Likeness",
    "found_again",
    "is_torn",
    "rows_astray",
    "tells_motion",
]

#: Where so much is alike, a closer look is not needed.
SURELY_ALIKE = 0.75
#: Least product of the shares of confirmed flow and of correlated places.
LEAST_FOUND = 0.1
#: Least share of the frame in which both directions agree and lead to the like, for the camera's motion to be
#: told: seas, skies and walls have at most 0.06, also with something that moves in front, real scenes 0.22.
LEAST_TOLD = 0.12
#: From one looked-at cell to the next, cells, and how many of them are the side of a window.
WINDOW_STEP, WINDOW_SIDE = 2, 5
#: A textured window's least variance, grey levels²; the least correlation of two that are alike; and the
#: share of the windows without which nothing is said by them.
TEXTURE, ALIKE, LEAST_TEXTURED = 16.0, 0.7, 0.002
#: From one looked-at cell to the next, cells.
STEP = 4
#: A cell is astray if the camera's motion leads it so far off, px of a 640×480 frame, or its flow is unsure.
ASTRAY_PX = 3.0
#: A row is torn if at least this share of it is astray now, and at most that was before; and most that is
#: astray in one of the rows beside a torn band: its edge is sharp.
TORN, WHOLE = 0.8, 0.5
#: Least height of a torn band, and most of what is torn, as shares of the frame's.
LEAST_BAND, MOST_BAND = 0.08, 0.9


@dataclass(frozen=True, slots=True)
class Likeness:
    """How two pictures look alike along the flow, window by window.

    Attributes
    ----------
    correlation : (rows, columns) float32
        In [-1, 1], whatever the light; 0 where the flow leads out of the picture.
    variance : (rows, columns) float32
        The larger of the two windows', grey levels²; 0 where the flow leads out of the picture.
    """

    correlation: Array
    variance: Array

    @classmethod
    def along(cls, flow: DenseFlow, before: Array, gray: Array) -> Likeness:
        """Compare windows of two pictures (h, w) uint8, as the flow sees them."""
        xs, ys, inside = _sources(flow.backward, np.float32(flow.side))
        old = cv2.remap(before, xs, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cls(*_correlated(old, np.ascontiguousarray(gray[::WINDOW_STEP, ::WINDOW_STEP]), inside))

    def share(self) -> float:
        """Return the share of the textured places that look alike; 1 if hardly any is textured."""
        textured = self.variance > TEXTURE
        if textured.mean() < LEAST_TEXTURED:
            return 1.0
        return float((self.correlation[textured] > ALIKE).mean())


def found_again(flow: DenseFlow, alike: Likeness) -> float:
    """How much of a picture is found again in the next one.

    Parameters
    ----------
    flow : DenseFlow
        Between the two, of which each direction was searched by itself.
    alike : Likeness
        Of the two along the flow.

    Returns
    -------
    float
        In [0, 1]. Below ``LEAST_FOUND`` the scene is another one.
    """
    return float(flow.backward_reliable.mean()) * alike.share()


def tells_motion(flow: DenseFlow, alike: Likeness) -> bool:
    """Whether enough is found again in the next picture to tell the camera's motion.

    Faint structure counts as well, for fog hides little of the motion. Parameters as of :func:`found_again`,
    but one direction of the flow may be the other turned around.
    """
    reliable = flow.backward_reliable[::WINDOW_STEP, ::WINDOW_STEP].astype(np.float32)
    confirmed = cv2.blur(reliable, (WINDOW_SIDE, WINDOW_SIDE)) > 0.5
    return float((confirmed & (alike.correlation > ALIKE)).mean()) >= LEAST_TOLD


@compiled
def _sources(backward: Array, side: np.float32) -> tuple[Array, Array, Array]:
    """Return x and y, cells, where the flow comes from at the samples; and whether that is in the picture."""
    height, width = backward.shape[:2]
    shape = (height + WINDOW_STEP - 1) // WINDOW_STEP, (width + WINDOW_STEP - 1) // WINDOW_STEP
    xs, ys, inside = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.bool_)
    for row in range(shape[0]):
        for column in range(shape[1]):
            y, x = WINDOW_STEP * row, WINDOW_STEP * column
            along = np.float32(x) + backward[y, x, 0] / side
            down = np.float32(y) + backward[y, x, 1] / side
            xs[row, column], ys[row, column] = along, down
            inside[row, column] = 0 <= along <= width - 1 and 0 <= down <= height - 1
    return xs, ys, inside


@compiled
def _correlated(old: Array, new: Array, inside: Array) -> tuple[Array, Array]:
    """Compute the fields of `Likeness` from samples of both pictures, which are mirrored at the border."""
    height, width = new.shape
    correlation, variance = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    reach, count = WINDOW_SIDE // 2, np.int32(WINDOW_SIDE * WINDOW_SIDE)
    # Sums of old, new, old², new² and old · new: over the rows of a window, and over all of it.
    columns, sums = np.empty((5, width + 2 * reach), np.int32), np.empty((5, width), np.int32)
    share, least = np.float32(1 / (WINDOW_SIDE * WINDOW_SIDE) ** 2), np.float32(1e-3)
    for y in range(height):
        columns[:] = 0
        for v in range(y - reach, y + reach + 1):
            before, after = old[mirrored(v, height)], new[mirrored(v, height)]
            _add_products(before, after, columns[:, reach : reach + width])
        for x in range(-reach, 0):
            end = width - 1 - x
            columns[:, reach + x] = columns[:, reach + mirrored(x, width)]
            columns[:, reach + end] = columns[:, reach + mirrored(end, width)]
        sums[:] = 0
        for moment in range(5):
            total = sums[moment]
            for u in range(WINDOW_SIDE):
                beside = columns[moment, u : u + width]
                for x in range(width):
                    total[x] += beside[x]
        first, second, squared, other_squared, both = sums[0], sums[1], sums[2], sums[3], sums[4]
        row, varied, known = correlation[y], variance[y], inside[y]
        for x in range(width):
            var_old = max(np.float32(count * squared[x] - first[x] * first[x]) * share, least)
            var_new = max(np.float32(count * other_squared[x] - second[x] * second[x]) * share, least)
            together = np.float32(count * both[x] - first[x] * second[x]) * share
            row[x] = np.float32(known[x]) * together / np.sqrt(var_old * var_new)
            varied[x] = np.float32(known[x]) * max(var_old, var_new)
    return correlation, variance


@inlined
def _add_products(before: Array, after: Array, sums: Array) -> None:
    first, second, squared, other_squared, both = sums[0], sums[1], sums[2], sums[3], sums[4]
    for x in range(before.size):
        one, other = np.int32(before[x]), np.int32(after[x])
        first[x] += one
        second[x] += other
        squared[x] += one * one
        other_squared[x] += other * other
        both[x] += one * other


def rows_astray(flow: DenseFlow, camera: Array, scale: float) -> Array:
    """Share of each row that does not move as the camera does.

    Parameters
    ----------
    flow : DenseFlow
    camera : (3, 3) float64
        Takes px of frame t to frame t−1.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (rows,) float32
        Of every ``STEP``-th row of cells, in [0, 1].
    """
    shares: Array = _rows_astray(
        flow.backward, flow.backward_reliable, camera, flow.side, np.float32(ASTRAY_PX * scale)
    )
    return shares


@compiled
def _rows_astray(flow: Array, reliable: Array, camera: Array, side: int, farthest: np.float32) -> Array:
    """Compute :func:`rows_astray`; cells that are farther from where the camera leads them are astray."""
    height, width = (reliable.shape[0] + STEP - 1) // STEP, (reliable.shape[1] + STEP - 1) // STEP
    shares, places = np.empty(height, np.float32), np.empty((width, 2), np.float32)
    for row in range(height):
        y = STEP * row
        for column in range(width):
            places[column, 0], places[column, 1] = np.float32(STEP * column * side), np.float32(y * side)
        motions, astray = homography_motion(camera, places), 0
        for column in range(width):
            moved, led = flow[y, STEP * column], motions[column]
            off = max(abs(moved[0] - led[0]), abs(moved[1] - led[1]))
            astray += int(off > farthest or not reliable[y, STEP * column])
        shares[row] = np.float32(astray) / np.float32(width)
    return shares


def is_torn(rows: Array, before: Array) -> bool:
    """Whether a band of rows has left the rest.

    Parameters
    ----------
    rows, before : (rows,) float32
        :func:`rows_astray` of the picture and of the one before; none for an epoch's first ones.
    """
    if rows.shape != before.shape:
        return False
    torn = rows >= TORN
    if rows.size == 0 or torn.mean() > MOST_BAND:
        return False
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], torn.astype(np.int8), [0]])))
    for start, end in zip(bounds[::2].tolist(), bounds[1::2].tolist(), strict=True):
        high = end - start >= LEAST_BAND * rows.size
        # The row on the edge itself may be cut through.
        outside = [rows[place] for place in (start - 2, end + 1) if 0 <= place < rows.size]
        if high and before[start:end].max() <= WHOLE and outside and min(outside) <= WHOLE:
            return True
    return False
