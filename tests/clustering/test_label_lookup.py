"""What a frame shows of a registry's rows, against NumPy."""

from __future__ import annotations

import numpy as np

from mlbs_actors.clustering.label_lookup import note_sightings


def test_rows_with_enough_trajectories_take_what_is_seen_and_the_others_keep_what_they_have() -> None:
    rng = np.random.default_rng(0)
    enough = np.array([True, False, True])
    means, fresh = rng.random((3, 4)).astype(np.float32), rng.random((3, 8)).astype(np.float32)
    seen, tracked = np.array([4, 5, 6]), np.array([1, 2, 3])
    centroids, velocities = rng.random((3, 2)), rng.random((3, 2))
    signatures = rng.random((3, 8)).astype(np.float32)
    signatures[2] = 0  # never seen before
    expected = [one.copy() for one in (seen, tracked, centroids, velocities, signatures)]
    for row in (0, 2):
        expected[0][row] = expected[1][row] = 9
        expected[2][row], expected[3][row] = means[row, :2], -means[row, 2:]
    expected[4][0] = np.float32(0.9) * signatures[0] + np.float32(0.1) * fresh[0]
    expected[4][2] = fresh[2]
    note_sightings(enough, means, fresh, 9, seen, tracked, centroids, velocities, signatures)
    for found, wanted in zip((seen, tracked, centroids, velocities, signatures), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)
