"""What DAVIS says of a measure over the frames of a sequence: its mean, its recall and its decay.

Recall is the share of the frames in which the measure is above 0.5. Decay is what it loses from the first
quarter of the frames to the last. The quarters share the frames at which they meet, as in the programs of
DAVIS and in TrackEval. Those keep the places of the quarters in 8 bits, so that they are wrong beyond 256
frames; these are right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

__all__ = ["FrameStatistics", "frame_statistics"]

_FOUND = 0.5
_QUARTERS = 4


class FrameStatistics(NamedTuple):
    """Mean and recall of a measure, in [0, 1], and its decay, in [−1, 1]; NaN without frames."""

    mean: float
    recall: float
    decay: float


def frame_statistics(values: Sequence[float]) -> FrameStatistics:
    """Summarise a measure over the frames of a sequence.

    Parameters
    ----------
    values : sequence of float
        One for each frame, in order, in [0, 1].
    """
    if not values:
        return FrameStatistics(math.nan, math.nan, math.nan)
    count = len(values)
    # 1-based places, where halves are rounded up; the last frame of a quarter is the first of the next.
    ends = np.round(np.linspace(1, count, _QUARTERS + 1) + 1e-10).astype(int) - 1
    first, last = values[: ends[1] + 1], values[ends[-2] :]
    return FrameStatistics(
        sum(values) / count,
        sum(value > _FOUND for value in values) / count,
        sum(first) / len(first) - sum(last) / len(last),
    )
