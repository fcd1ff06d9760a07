"""The grid of nodes of a motion field, and bilinear interpolation between nodes, points and pixels.

A node lies at the centre of its cell of ``spacing``² pixels. A point has shares in the four nodes around it,
and a pixel is interpolated from them.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "bilinear_taps",
    "grid_shape",
    "lump",
    "node_positions",
    "point_misfit",
    "to_pixels",
]


@compiled
def grid_shape(shape: tuple[int, int], spacing: int) -> tuple[int, int]:
    """Return the rows and columns of nodes of an (h, w) region."""
    return -(-shape[0] // spacing), -(-shape[1] // spacing)


def node_positions(shape: tuple[int, int], spacing: int) -> Array:
    """Return the positions of the nodes of a region.

    Parameters
    ----------
    shape : (h, w)
        Size of the region, px.
    spacing : int
        px.

    Returns
    -------
    (⌈h/spacing⌉, ⌈w/spacing⌉, 2) float32
        Region-local (x, y) of each node, px. The last ones may lie past the border.
    """
    rows, columns = grid_shape(shape, spacing)
    nodes = np.empty((rows, columns, 2), np.float32)
    nodes[..., 0] = (np.arange(columns) + 0.5) * spacing - 0.5
    nodes[..., 1] = ((np.arange(rows) + 0.5) * spacing - 0.5)[:, None]
    return nodes


@compiled
def to_pixels(values: Array, spacing: int, height: int, width: int) -> Array:
    """Interpolate nodes' values (gh, gw, c) at the pixels of an (h, w) region, (h, w, c), bilinear, float32.

    Values are constant past the outer nodes.
    """
    rows, columns, components = values.shape
    pixels = np.empty((height, width, components), np.float32)
    if pixels.size == 0:
        return pixels
    left, right, along = _pixel_taps(width, columns, spacing)
    top, bottom, down = _pixel_taps(height, rows, spacing)
    length = width * components
    wide, flat, one = np.empty((rows, length), np.float32), pixels.reshape(-1), np.float32(1)
    for v in range(rows):
        nodes, line = values[v].reshape(-1), wide[v]
        for x in range(width):
            share = along[x]
            for component in range(components):
                before = nodes[np.uint64(components * left[x] + component)]
                after = nodes[np.uint64(components * right[x] + component)]
                line[np.uint64(components * x + component)] = before * (one - share) + after * share
    for y in range(height):
        above, below, share = wide[top[y]], wide[bottom[y]], down[y]
        line = flat[y * length : (y + 1) * length]
        for i in range(length):
            line[i] = above[i] * (one - share) + below[i] * share
    return pixels


@compiled
def _pixel_taps(length: int, nodes: int, spacing: int) -> tuple[Array, Array, Array]:
    """Return the two nodes along one axis that each pixel lies between, and the share of the second."""
    first, second = np.empty(length, np.int64), np.empty(length, np.int64)
    share = np.empty(length, np.float32)
    for i in range(length):
        place = np.float32((i + 0.5) * (1.0 / spacing) - 0.5)
        whole = np.floor(place)
        first[i], share[i] = min(max(int(whole), 0), nodes - 1), place - whole
        second[i] = min(max(int(whole) + 1, 0), nodes - 1)
    return first, second, share


@compiled
def bilinear_taps(points: Array, rows: int, columns: int, spacing: int) -> tuple[Array, Array]:
    """Return the indices (n, 4) of the nodes around each point and its shares (n, 4) in them, of sum 1."""
    nodes, shares = np.empty((points.shape[0], 4), np.int64), np.empty((points.shape[0], 4))
    for point in range(points.shape[0]):
        u = min(max((np.float64(points[point, 0]) + 0.5) / spacing - 0.5, 0.0), columns - 1.0)
        v = min(max((np.float64(points[point, 1]) + 0.5) / spacing - 0.5, 0.0), rows - 1.0)
        left, top = int(u), int(v)
        right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
        along, down = u - left, v - top
        nodes[point, 0], nodes[point, 1] = top * columns + left, top * columns + right
        nodes[point, 2], nodes[point, 3] = bottom * columns + left, bottom * columns + right
        shares[point, 0], shares[point, 1] = (1 - down) * (1 - along), (1 - down) * along
        shares[point, 2], shares[point, 3] = down * (1 - along), down * along
    return nodes, shares


@compiled
def point_misfit(values: Array, field: Array, nodes: Array, shares: Array) -> Array:
    """Return points' values (n, 2) less those of a (2, gh, gw) field."""
    flat, count = field.reshape(-1), field.shape[1] * field.shape[2]
    misfit = np.empty((values.shape[0], 2))
    for point in range(values.shape[0]):
        for axis in range(2):
            total = 0.0
            for tap in range(4):
                total += shares[point, tap] * flat[axis * count + nodes[point, tap]]
            misfit[point, axis] = values[point, axis] - total
    return misfit


@compiled
def lump(
    nodes: Array, shares: Array, precisions: Array, measured: Array, prior_precision: float,
    shape: tuple[int, int],
) -> Array:  # fmt: skip
    """Sum evidence on the nodes by the points' shares in them.

    Parameters
    ----------
    nodes, shares : (n, 4)
        Of :func:`bilinear_taps`.
    precisions : (n,) float64
        Of the points.
    measured : (n, 2)
        The measurements.
    prior_precision : float
        Of every node.
    shape : (gh, gw)
        Of the grid.

    Returns
    -------
    (3, gh, gw) float64
        Precision, and precision times measurement in x and y.
    """
    total = np.zeros((3, shape[0] * shape[1]))
    total[0] = prior_precision
    for point in range(nodes.shape[0]):
        for tap in range(4):
            node, amount = nodes[point, tap], shares[point, tap] * precisions[point]
            total[0, node] += amount
            total[1, node] += amount * measured[point, 0]
            total[2, node] += amount * measured[point, 1]
    return total.reshape(3, shape[0], shape[1])
