"""What is kept of a frame that waits, against NumPy's own conversions."""

from __future__ import annotations

import numpy as np

from mlbs_actors import held_frames
from mlbs_actors.messages import UNEXPLAINED_STEP

RNG = np.random.default_rng(2)


def test_flow_in_half_precision_is_rounded_as_numpy_rounds_it() -> None:
    sizes = 10.0 ** RNG.uniform(-9, 4, (60, 50, 2))
    flow = (RNG.choice([-1.0, 1.0], sizes.shape) * sizes).astype(np.float32)
    flow[0] = 0
    halved = held_frames._halved(flow)
    assert halved.dtype == np.float16
    np.testing.assert_array_equal(halved, flow.astype(np.float16))


def test_what_is_unexplained_is_counted_in_whole_steps_up_to_255() -> None:
    steps = np.r_[np.arange(0, 300, 0.25), 1e6].astype(np.float32)
    found = held_frames._quantised(steps[None] * np.float32(UNEXPLAINED_STEP))
    np.testing.assert_array_equal(found[0], np.minimum(np.rint(steps), 255))
