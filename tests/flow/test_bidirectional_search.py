"""The search in both directions where it has only one level."""

from __future__ import annotations

import numpy as np
from flow_fakes import dense_flow

from mlbs_actors.config import Config
from mlbs_actors.messages import Region


def test_where_the_finest_level_is_the_coarsest_what_lies_outside_the_boxes_moves_too() -> None:
    canvas = np.random.default_rng(0).integers(0, 256, (60, 70)).astype(np.uint8)
    first, second = canvas[4:44, 4:44].copy(), canvas[4:44, 3:43].copy()  # things move by (+1, 0)
    flow = dense_flow(first, second, 1, Config(), [Region(0, 0, 16, 16)])
    np.testing.assert_allclose(np.median(flow.backward[20:, 20:], axis=(0, 1)), [-1, 0], atol=0.1)
    np.testing.assert_allclose(np.median(flow.forward[20:, 20:], axis=(0, 1)), [1, 0], atol=0.1)
