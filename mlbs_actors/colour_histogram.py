"""The colours of a whole layer: a three-dimensional histogram with exponential forgetting.

Where a layer has no samples of its own at a pixel (newly uncovered background, the far side of a turning
object) its regional colours still say something. The histogram costs O(pixels) a frame, whatever it holds.

The density of a colour c is a mixture

    p(c) = (1 − u) · (K * n)(c) / Σn / V + u / 256³

of the smoothed histogram (n the bins' weights, K the separable kernel [¼, ½, ¼] over neighbouring bins with
reflected ends, V the colours in a bin) and of a uniform share u, so that a colour never seen is unlikely and
not impossible. Its unit, nats per unit RGB volume (1/level³), is that of :mod:`mlbs_actors.kde`: the two may
be compared and mixed.

Differs from the paper: the paper has only per-pixel models; this is the regional one that speaks where they
are silent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mlbs_actors.messages import Array

__all__ = ["ColourHistogram"]

_LEVELS = 256


@dataclass(frozen=True, slots=True)
class ColourHistogram:
    """Regional colour model of one layer.

    Attributes
    ----------
    weights : (bins, bins, bins) float32
        Weight of each colour bin (blue, green, red), in frames: every update adds 1 in all.
    forgetting : float
        Share of the old weights that each update forgets, in [0, 1).
    uniform_share : float
        Share u of the uniform density, in (0, 1].
    """

    weights: Array
    forgetting: float
    uniform_share: float

    @staticmethod
    def empty(bins: int = 16, forgetting: float = 0.05, uniform_share: float = 0.01) -> ColourHistogram:
        """Return the model of a layer that has seen nothing: every colour is equally likely.

        Parameters
        ----------
        bins : int
            Bins a channel; a divisor of 256.
        forgetting : float
            Share of the old weights that each update forgets, in [0, 1).
        uniform_share : float
            Share of the uniform density, in (0, 1].
        """
        return ColourHistogram(np.zeros((bins, bins, bins), np.float32), forgetting, uniform_share)

    def update(self, image: Array, mask: Array) -> ColourHistogram:
        """Return the model after one more frame.

        Parameters
        ----------
        image : (h, w, 3) uint8
            Colours, BGR.
        mask : (h, w) bool
            The layer's pixels. Without any, nothing is learnt and nothing forgotten.
        """
        counts = np.zeros(self.weights.size, np.int64)
        total = _count(image, mask, self.weights.shape[0], counts)
        if total == 0:
            return self
        share = (counts / total).reshape(self.weights.shape)
        weights = ((1.0 - self.forgetting) * self.weights + share).astype(np.float32)
        return ColourHistogram(weights, self.forgetting, self.uniform_share)

    def log_likelihood(self, image: Array) -> Array:
        """Log density of every pixel's colour.

        Parameters
        ----------
        image : (h, w, 3) uint8

        Returns
        -------
        (h, w) float32
            Nats per unit RGB volume; at least log(u / 256³), and log(1 / 256³) everywhere for an empty model.
        """
        table = self._log_density()
        result = np.empty(image.shape[:2], np.float32)
        _look_up(image, table.ravel(), self.weights.shape[0], result)
        return result

    def _log_density(self) -> Array:
        uniform = 1.0 / float(_LEVELS) ** 3
        total = float(self.weights.sum(dtype=np.float64))
        if total == 0.0:
            return np.full(self.weights.shape, np.log(uniform), np.float32)
        smooth = self.weights.astype(np.float64)
        for axis in range(3):
            smooth = _smooth(smooth, axis)
        bin_volume = (_LEVELS / self.weights.shape[0]) ** 3
        density = (1.0 - self.uniform_share) * smooth / (total * bin_volume) + self.uniform_share * uniform
        log_density: Array = np.log(density).astype(np.float32)
        return log_density


def _smooth(values: Array, axis: int) -> Array:
    """Kernel [¼, ½, ¼] along one axis with reflected ends, which keeps the sum."""
    padding = [(1, 1) if other == axis else (0, 0) for other in range(values.ndim)]
    padded = np.moveaxis(np.pad(values, padding, mode="symmetric"), axis, 0)
    smoothed: Array = np.moveaxis(0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:], 0, axis)
    return smoothed


@njit(cache=True)
def _bin(image: Array, y: int, x: int, bins: int) -> int:
    blue = image[y, x, 0] * bins // _LEVELS
    green = image[y, x, 1] * bins // _LEVELS
    red = image[y, x, 2] * bins // _LEVELS
    return int((blue * bins + green) * bins + red)


@njit(cache=True)
def _count(image: Array, mask: Array, bins: int, counts: Array) -> int:
    total = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if mask[y, x]:
                counts[_bin(image, y, x, bins)] += 1
                total += 1
    return total


@njit(cache=True)
def _look_up(image: Array, table: Array, bins: int, result: Array) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            result[y, x] = table[_bin(image, y, x, bins)]
