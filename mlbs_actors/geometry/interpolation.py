"""Bilinear interpolation of flow and maps of a frame's cells."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.messages import Array

__all__ = ["sample_flow", "sample_map"]

#: Fractions of a pixel are rounded to multiples of this, as OpenCV's ``remap`` does with two channels.
PARTS = 32

_ONE, _HALF = np.float32(1), np.float32(0.5)


@compiled
def sample_flow(flow: Array, points: Array, side: int) -> Array:
    """Interpolate flow vectors at positions in the frame.

    Parameters
    ----------
    flow : (h, w, c) float32
    points : (n, 2) float32
        (x, y), px.
    side : int
        Of a cell of the grid, px.

    Returns
    -------
    (n, c) float32
        Constant beyond the centres of the outermost pixels.
    """
    height, width, channels = flow.shape
    step = np.float32(side)
    sampled = np.empty((len(points), channels), np.float32)
    for point in range(len(points)):
        x = int(np.rint(PARTS * ((points[point, 0] + _HALF) / step - _HALF)))
        y = int(np.rint(PARTS * ((points[point, 1] + _HALF) / step - _HALF)))
        along, across = np.float32(x % PARTS) / np.float32(PARTS), np.float32(y % PARTS) / np.float32(PARTS)
        left, right = _beside(x // PARTS, width)
        top, bottom = _beside(y // PARTS, height)
        w00, w01 = (_ONE - across) * (_ONE - along), (_ONE - across) * along
        w10, w11 = across * (_ONE - along), across * along
        for channel in range(channels):
            upper = w00 * flow[top, left, channel] + w01 * flow[top, right, channel]
            sampled[point, channel] = (
                upper + w10 * flow[bottom, left, channel] + w11 * flow[bottom, right, channel]
            )
    return sampled


@compiled
def sample_map(values: Array, points: Array, side: int) -> Array:
    """Interpolate a map (h, w) float32, (n,) float32; otherwise as :func:`sample_flow`."""
    height, width = values.shape
    step = np.float32(side)
    sampled = np.empty(len(points), np.float32)
    for point in range(len(points)):
        x = (points[point, 0] + _HALF) / step - _HALF
        y = (points[point, 1] + _HALF) / step - _HALF
        along, across = x - np.floor(x), y - np.floor(y)
        left, right = _beside(int(np.floor(x)), width)
        top, bottom = _beside(int(np.floor(y)), height)
        upper = values[top, left] + along * (values[top, right] - values[top, left])
        lower = values[bottom, left] + along * (values[bottom, right] - values[bottom, left])
        sampled[point] = upper + across * (lower - upper)
    return sampled


@inlined
def _beside(place: int, count: int) -> tuple[int, int]:
    """Return an index and the next one, both clipped."""
    return min(max(place, 0), count - 1), min(max(place + 1, 0), count - 1)
