"""What is kept of a frame that waits, against NumPy's own conversions."""

from __future__ import annotations

import numpy as np

from mlbs_actors.clustering.label_index import distinct_labels
from mlbs_actors.coordinator import held_frames
from mlbs_actors.messages import UNEXPLAINED_STEP

RNG = np.random.default_rng(2)


def test_what_is_unexplained_is_counted_in_whole_steps_up_to_255() -> None:
    steps = np.r_[np.arange(0, 300, 0.25), 1e6].astype(np.float32)
    found = held_frames._quantised(steps[None] * np.float32(UNEXPLAINED_STEP))
    np.testing.assert_array_equal(found[0], np.minimum(np.rint(steps), 255))


def test_trajectories_are_told_apart_by_layer_where_they_tell_something() -> None:
    rng = np.random.default_rng(0)
    live, owner = np.array([0, 2, 5, 7]), rng.choice([-1, 0, 2, 7], 60)
    evidence = rng.normal(size=60).astype(np.float32)
    positions, motions = rng.random((2, 60, 2)).astype(np.float32)
    assert distinct_labels(owner) == {0, 2, 7}
    there, moved, starts = held_frames.by_layer(live, owner, evidence, np.float32(0.25), positions, motions)
    for layer, start, end in zip(live, starts, starts[1:], strict=False):
        telling = (owner == layer) & ((evidence >= 0.25) | (layer == 0))
        np.testing.assert_array_equal(there[start:end], positions[telling])
        np.testing.assert_array_equal(moved[start:end], motions[telling])
    assert starts[-1] == len(there) == len(moved)
