"""Pictures of more than 8 bits: one range of values for a whole sequence, so that nothing flickers.

Of 12 bits in 16, or of a thermal picture's few kelvins, the higher 8 bits show next to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["ValueRange"]

#: Share of the values that may lie below the range, and above it: dead pixels do.
_OUTSIDE = 0.001
#: About so many pixels of each sample are looked at.
_SAMPLED_PIXELS = 100_000
#: Of 16 bits the higher 8 are taken if they have at least so many levels.
_LEAST_LEVELS = 64


@dataclass(frozen=True, slots=True)
class ValueRange:
    """The values that become black and white.

    Attributes
    ----------
    low, high : float
    """

    low: float
    high: float

    @staticmethod
    def of(samples: Iterable[Array]) -> ValueRange | None:
        """Find the range that a sequence needs.

        Parameters
        ----------
        samples : iterable of (H, W) or (H, W, 3)
            Some of its pictures, of any type.

        Returns
        -------
        ValueRange or None
            None if the first sample has 8 bits, or the higher 8 of 16 show enough.
        """
        values = []
        for sample in samples:
            if sample.dtype == np.uint8:
                break
            step = max(1, round((sample.shape[0] * sample.shape[1] / _SAMPLED_PIXELS) ** 0.5))
            some = sample[::step, ::step]
            values.append(some[np.isfinite(some)])
        if not values or not (known := np.concatenate(values)).size:
            return None
        low, high = (float(value) for value in np.quantile(known, [_OUTSIDE, 1.0 - _OUTSIDE]))
        if known.dtype == np.uint16 and high - low >= _LEAST_LEVELS * 256:
            return None
        return ValueRange(low, high)

    def stretched(self, image: Array) -> Array:
        """Convert a picture (H, W) or (H, W, 3) of any type to (H, W, 3) uint8; one of 8 bits stays."""
        if image.dtype != np.uint8:
            per_value = 255.0 / (self.high - self.low) if self.high > self.low else 0.0
            levels = (np.nan_to_num(image.astype(np.float32)) - np.float32(self.low)) * np.float32(per_value)
            image = np.rint(np.clip(levels, 0, 255)).astype(np.uint8)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)) if image.ndim == 2 else image
