"""Contact shadows: the strip between an object and the ground that no light reaches.

Not in the paper. There, as between the wheels of a car, the ground's colour is lost
(:mod:`mlbs_actors.segmentation.shadows`), and black tyres and bumpers look alike. Position decides: a flat,
smooth, dark strip at the foot of an object that stands on the ground. Feet of one object are at different
heights in the picture, so each piece of it is examined by itself.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.config import SegmentationConfig
from mlbs_actors.geometry.boxes import grown, slices_in
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array, Region
from mlbs_actors.segmentation.label_runs import label_runs
from mlbs_actors.segmentation.shadows import Darkening

__all__ = ["contact_shadow"]


def contact_shadow(
    labels: Array, frame: Array, dark: Darkening, side: int, scale: float, config: SegmentationConfig
) -> Array:
    """Find the dark strip between an object's foot and the ground that the label map gives to the object.

    Parameters
    ----------
    labels : (h, w) unsigned integer
        A frame's label map without pinholes, 0 = background, or one of its boxes with only background along
        the sides that are not the frame's border.
    frame : (h, w, 3) uint8
        The same box of the frame.
    dark : Darkening
        Of its pixels, or of the box's cells of ``side`` px.
    side : int
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (h, w) bool
    """
    limits = map(np.float32, (config.contact_dark, config.channel_spread, config.channel_noise))
    unlit = _unlit(dark.mean, dark.spread, dark.brightness, *limits)
    found = np.zeros(labels.shape, np.bool_)
    if not unlit.any():
        return found
    runs = label_runs(labels, True)
    pieces = _unlit_pieces(labels, *runs, unlit, side)
    edge = 2 * int(config.contact_edge_px * scale) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (edge, edge))
    steepest, gap = np.float32(config.contact_smooth / scale), config.contact_gap_px * scale
    for piece, x, y, width, height in pieces.tolist():
        feet, least = Region(x, y + height // 2, width, height - height // 2), config.contact_width * height
        body, above, foot, (left, top, right, bottom) = _foot(
            labels, runs, piece, feet.box, unlit, side, config.contact_shadow * height, least
        )
        if right <= left:
            continue
        wide = Region(feet.x + left, feet.y + top, right - left, bottom - top)
        core = _resting(foot, above, _steepness(frame, wide), left, top, steepest, least, gap)
        _take_strip(cv2.dilate(core, disc), foot, body, found, feet.x, feet.y)
    return found


@compiled
def _unlit(
    mean: Array, spread: Array, brightness: Array, darkest: np.float32, widest: np.float32, noise: np.float32
) -> Array:
    """Mark pixels much darker than the ground, and equally so in all channels."""
    unlit = np.empty(mean.shape, np.bool_)
    for y in range(mean.shape[0]):
        for x in range(mean.shape[1]):
            tolerance = widest + noise / brightness[y, x]
            unlit[y, x] = mean[y, x] < darkest and spread[y, x] < tolerance
    return unlit


@compiled
def _unlit_pieces(
    labels: Array, rows: Array, starts: Array, ends: Array, component: Array, unlit: Array, side: int
) -> Array:
    """Return number, x, y, width and height, (n, 5), of the objects' components that have an unlit pixel in
    their lower half."""
    count = component.max() + 1
    left, right = np.full(count, labels.shape[1]), np.zeros(count, np.int64)
    top, bottom = np.full(count, labels.shape[0]), np.zeros(count, np.int64)
    lowest = np.full(count, -1)  # the lowest unlit row
    for run in range(rows.size):
        y = rows[run]
        if labels[y, starts[run]] == BACKGROUND:
            continue
        piece, cells = component[run], unlit[y // side]
        left[piece], right[piece] = min(left[piece], starts[run]), max(right[piece], ends[run])
        top[piece], bottom[piece] = min(top[piece], y), y + 1
        for u in range(starts[run] // side, (ends[run] - 1) // side + 1):
            if cells[u]:
                lowest[piece] = y
                break
    pieces = np.empty((count, 5), np.int64)
    found = 0
    for piece in range(count):
        height = bottom[piece] - top[piece]
        if lowest[piece] >= top[piece] + height // 2:
            pieces[found, 0], pieces[found, 1], pieces[found, 2] = piece, left[piece], top[piece]
            pieces[found, 3], pieces[found, 4] = right[piece] - left[piece], height
            found += 1
    return pieces[:found]


@compiled
def _foot(
    labels: Array, runs: tuple[Array, Array, Array, Array], piece: int, box: tuple[int, int, int, int],
    unlit: Array, side: int, highest: float, least: float,
) -> tuple[Array, Array, Array, tuple[int, int, int, int]]:  # fmt: skip
    """Crop to the lower half of a piece. Return the piece; the distance in px down to the first pixel of no
    object, over H if the frame ends first; the unlit pixels close enough to the ground; and the box (left,
    top, right, bottom) of those in wide enough runs, empty if there are none."""
    (rows, starts, ends, component), (left, top, width, height) = runs, box
    body = np.zeros((height, width), np.bool_)
    for run in range(rows.size):
        if component[run] == piece and rows[run] >= top:
            body[rows[run] - top, starts[run] - left : ends[run] - left] = True
    above, foot = np.empty((height, width), np.int32), np.empty((height, width), np.bool_)
    below = top + height
    climb = np.empty(width, np.int32)
    for x in range(width):
        ends_first = below == len(labels) or labels[below, left + x] > BACKGROUND
        climb[x] = len(labels) if ends_first else 0
    for y in range(height - 1, -1, -1):
        for x in range(width):
            climb[x] = climb[x] + 1 if labels[top + y, left + x] > BACKGROUND else 0
            above[y, x] = climb[x]
            dark = body[y, x] and unlit[(top + y) // side, (left + x) // side]
            foot[y, x] = dark and climb[x] <= highest
    wide = _wide(foot, least)
    first, last, highest_row, lowest_row = width, 0, height, 0
    for y in range(height):
        for x in range(width):
            if wide[y, x]:
                first, last = min(first, x), max(last, x + 1)
                highest_row, lowest_row = min(highest_row, y), y + 1
    return body, above, foot, (first, highest_row, last, lowest_row)


@compiled
def _wide(mask: Array, least: float) -> Array:
    """Keep the horizontal runs of a mask of at least this length, px, rounded down to an odd number."""
    wide = np.zeros(mask.shape, np.bool_)
    length = 2 * max(1, int(least / 2)) + 1
    for y in range(mask.shape[0]):
        start = 0
        for x in range(mask.shape[1] + 1):
            if x == mask.shape[1] or not mask[y, x]:
                if x - start >= length:
                    wide[y, start:x] = True
                start = x + 1
    return wide


def _steepness(frame: Array, box: Region) -> Array:
    """Average the gradient over 5×5 px in a box, grey levels/px."""
    around = grown(box, 3, frame.shape)
    gray = cv2.cvtColor(frame[around.slices], cv2.COLOR_BGR2GRAY).astype(np.float32)
    slopes = (cv2.Sobel(gray, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    return np.ascontiguousarray(cv2.blur(np.hypot(*slopes), (5, 5))[slices_in(box, around)])


@compiled
def _resting(
    foot: Array, above: Array, slopes: Array, left: int, top: int, steepest: np.float32, least: float,
    gap: float,
) -> Array:  # fmt: skip
    """Keep the flat, wide parts of a foot that are connected, also by corners, to pixels near the ground.

    0 or 1, uint8; the slopes are those of a box in it, beyond which nothing is wide enough.
    """
    height, width = slopes.shape
    flat = np.empty((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            flat[y, x] = foot[top + y, left + x] and slopes[y, x] < steepest
    open_pixel = _wide(flat, least)
    resting = np.zeros(foot.shape, np.uint8)
    queue = np.empty(height * width, np.int32)
    tail = 0
    for y in range(height):
        for x in range(width):
            if open_pixel[y, x] and above[top + y, left + x] <= gap:
                open_pixel[y, x] = False
                queue[tail] = y * width + x
                tail += 1
    head = 0
    while head < tail:
        y, x = queue[head] // width, queue[head] % width
        head += 1
        resting[top + y, left + x] = 1
        for v in range(max(y - 1, 0), min(y + 2, height)):
            for u in range(max(x - 1, 0), min(x + 2, width)):
                if open_pixel[v, u]:
                    open_pixel[v, u] = False
                    queue[tail] = v * width + u
                    tail += 1
    return resting


@compiled
def _take_strip(grown_core: Array, foot: Array, body: Array, found: Array, left: int, top: int) -> None:
    """Add the foot's pixels within reach of the strip's edges, and the body below them down to the ground,
    the shadow's lighter rim. The foot's box begins at (left, top) of ``found``."""
    height, width = foot.shape
    over = np.zeros(width, np.bool_)
    for y in range(height):
        for x in range(width):
            over[x] = (over[x] and body[y, x]) or (foot[y, x] and grown_core[y, x] > 0)
            found[top + y, left + x] |= over[x]
