"""Flow between grey pictures, without a frame they come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mlbs_actors.config import Config
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import FlowEstimator, Picture, picture_of
from mlbs_actors.messages import Array, Region


def flow_gray(frame: Array, side: int) -> Array:
    return picture_of(frame, side, False).gray


def dense_flow(
    previous: Array, current: Array, side: int, config: Config, focus: Sequence[Region] | None = None
) -> DenseFlow:
    nothing = np.zeros((0, 0, 3), np.uint8)
    before, now = (Picture(nothing, one, nothing) for one in (previous, current))
    return FlowEstimator(config).between(before, now, side, focus)
