"""What an outline costs between two pixels: little where the image has an edge (§7).

Differs from the paper: its pair factor q_ij = ±1 makes the pair term submodular only where its logarithm is
positive. Here it is a contrast-sensitive Potts weight w ≥ 0, as in the authors' program, with the two
diagonal directions divided by √2: an outline then costs the same per length along an axis and a diagonal.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.label_cost_energy import NEIGHBOUR_OFFSETS
from mlbs_actors.messages import Array

__all__ = ["COST_QUANTUM", "MAX_COST", "contrast_weights"]

#: Unit of all costs, nats.
COST_QUANTUM = 1.0 / 1024.0

#: Largest unary cost or pair weight, quanta: sums of nine still fit into 32 bits.
MAX_COST = 2**24


def contrast_weights(image: Array, strength: float = 0.8, scale: float = 200.0) -> Array:
    """Contrast-sensitive Potts weights: strength · exp(−|ΔRGB|² / scale), diagonals divided by √2.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Colour image; the order of the channels does not matter.
    strength : float
        Weight between equal colours, nats, from 0 to ``MAX_COST`` quanta.
    scale : float
        Squared colour distance, summed over the channels, at which the weight has fallen to 1/e, > 0.

    Returns
    -------
    (H, W, 4) int32
        To the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4; 0 where it would be outside. Units of
        ``COST_QUANTUM``.

    Raises
    ------
    FrameError
        The image is not (H, W, 3) uint8.
    ConfigError
        ``strength`` or ``scale`` is out of range.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise FrameError(f"Give an (H, W, 3) uint8 image; this one is {image.shape} {image.dtype}.")
    if not 0 <= strength <= MAX_COST * COST_QUANTUM:
        raise ConfigError(
            f"The contrast strength is {strength}; give a value from 0 to {MAX_COST * COST_QUANTUM:g} nats."
        )
    if not 0 < scale < math.inf:
        raise ConfigError(f"The contrast scale is {scale}; give a positive number of squared grey levels.")
    # Squared distances are integers; past the one where the weight falls below half a quantum it is 0.
    reach = scale * math.log(max(1.0, 2.0 * strength / COST_QUANTUM))
    straight = strength * np.exp(-np.arange(int(min(reach, 3 * 255**2)) + 1) / scale)
    table = np.stack([straight, straight, straight / math.sqrt(2.0), straight / math.sqrt(2.0)])
    return _contrast(np.ascontiguousarray(image), np.rint(table / COST_QUANTUM).astype(np.int32))


@njit(cache=True)
def _contrast(image: Array, table: Array) -> Array:
    """Weights to the first four neighbours, by direction and squared colour distance; 0 past the table."""
    height, width, _ = image.shape
    weights = np.zeros((height, width, 4), np.int32)
    for y in range(height):
        for x in range(width):
            for k in range(4):
                v, u = y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]
                if not (v < height and 0 <= u < width):
                    continue
                distance = np.int64(0)
                for channel in range(3):
                    step = np.int64(image[y, x, channel]) - np.int64(image[v, u, channel])
                    distance += step * step
                if distance < table.shape[1]:
                    weights[y, x, k] = table[k, distance]
    return weights
