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

import cv2
import numpy as np

from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import homography_motion

__all__ = [
    "LEAST_FOUND",
    "SURELY_ALIKE",
    "correlated",
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
#: Side of the windows that are correlated, and from one looked-at cell to the next, cells.
WINDOW, WINDOW_STEP = 10, 2
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


def found_again(flow: DenseFlow, before: Array, gray: Array) -> float:
    """How much of a picture is found again in the next one.

    Parameters
    ----------
    flow : DenseFlow
        Between the two, of which each direction was searched by itself.
    before, gray : (h, w) uint8
        The two, as the flow sees them.

    Returns
    -------
    float
        In [0, 1]. Below ``LEAST_FOUND`` the scene is another one.
    """
    return float(flow.backward_reliable.mean()) * correlated(flow, before, gray)


def correlated(flow: DenseFlow, before: Array, gray: Array) -> float:
    """Share of the textured places that look alike in two pictures, as the flow leads from one to the other.

    The correlation does not depend on the light. Parameters as of :func:`found_again`.
    """
    correlation, variance = _correlation(flow, before, gray)
    textured = variance > TEXTURE
    if textured.mean() < LEAST_TEXTURED:
        return 1.0
    return float((correlation[textured] > ALIKE).mean())


def tells_motion(flow: DenseFlow, before: Array, gray: Array) -> bool:
    """Whether enough is found again in the next picture to tell the camera's motion.

    Faint structure counts as well, for fog hides little of the motion. Parameters as of :func:`found_again`,
    but one direction of the flow may be the other turned around.
    """
    correlation, _ = _correlation(flow, before, gray)
    confirmed = _windows(flow.backward_reliable[::WINDOW_STEP, ::WINDOW_STEP].astype(np.float32)) > 0.5
    return float((confirmed & (correlation > ALIKE)).mean()) >= LEAST_TOLD


def _correlation(flow: DenseFlow, before: Array, gray: Array) -> tuple[Array, Array]:
    """Correlation of the windows along the flow, and the larger variance of each two, grey levels².

    Both are 0 where the flow leads out of the picture.
    """
    height, width = gray.shape
    ys, xs = np.mgrid[0:height:WINDOW_STEP, 0:width:WINDOW_STEP].astype(np.float32)
    moved = flow.backward[::WINDOW_STEP, ::WINDOW_STEP] / np.float32(flow.side)
    xs, ys = xs + moved[..., 0], ys + moved[..., 1]
    inside = (xs >= 0) & (xs <= width - 1) & (ys >= 0) & (ys <= height - 1)
    old = cv2.remap(before, xs, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    new = gray[::WINDOW_STEP, ::WINDOW_STEP].astype(np.float32)
    mean_old, mean_new = _windows(old), _windows(new)
    var_old = np.maximum(_windows(old * old) - mean_old * mean_old, 1e-3)
    var_new = np.maximum(_windows(new * new) - mean_new * mean_new, 1e-3)
    correlation = (_windows(old * new) - mean_old * mean_new) / np.sqrt(var_old * var_new)
    return inside * correlation, inside * np.maximum(var_old, var_new)


def _windows(values: Array) -> Array:
    side = WINDOW // WINDOW_STEP
    return cv2.blur(values, (side, side))


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
    motions = flow.backward[::STEP, ::STEP]
    height, width = motions.shape[:2]
    ys, xs = np.mgrid[0:height, 0:width]
    step = STEP * flow.side
    places = np.stack([xs, ys], axis=-1).reshape(-1, 2).astype(np.float32) * np.float32(step)
    off = np.abs(motions.reshape(-1, 2) - homography_motion(camera, places)).max(axis=1)
    astray = (off > ASTRAY_PX * scale).reshape(height, width) | ~flow.backward_reliable[::STEP, ::STEP]
    return np.asarray(astray.mean(axis=1), np.float32)


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
