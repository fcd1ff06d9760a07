"""Where an object may learn, and how far it reaches, against loops over cells and trajectories."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from layer_fakes import frame_of

from mlbs_actors.config import Config, length_scale
from mlbs_actors.layer.learning import object_support
from mlbs_actors.messages import UNEXPLAINED_STEP, Array, LayerTracks, Region, readonly

SHAPE = 41, 52
CLOSE, LEARN, NEAR, FADE = 0.0, 9.0, 6.0, 20.0
LEAST = 100.0


@pytest.mark.parametrize(("left", "top"), [(0, 0), (11, 6), (12, 7)])
@pytest.mark.parametrize("side", [1, 2])
def test_an_object_learns_nearest_to_its_own_trajectories_and_costs_more_away_from_them(
    left: int, top: int, side: int
) -> None:
    rng = np.random.default_rng(left)
    corner, size = side * np.array([left, top]), side * np.array(SHAPE[::-1])
    before, own, after = (
        (corner + size * (0.2 + 0.6 * rng.random((count, 2)))).astype(np.float32) for count in (9, 6, 4)
    )
    unexplained = rng.integers(0, 256, (SHAPE[0] + top, SHAPE[1] + left)).astype(np.uint8)
    frame = np.array(unexplained.shape) * side
    evidence = replace(
        frame_of([]),
        shape=(int(frame[0]), int(frame[1])),
        positions=np.concatenate([before, own, after]),
        unexplained=unexplained,
    )
    tracks = LayerTracks(1, "object", -1, len(before), len(before) + len(own))
    cells = Region(left, top, SHAPE[1], SHAPE[0])
    lengths = {
        f"{name}_px": length / length_scale(*evidence.shape)
        for name, length in zip(("close", "learn", "near", "fade"), (CLOSE, LEARN, NEAR, FADE), strict=True)
    }
    config = Config.model_validate(
        {"posterior": lengths, "layers": {"unexplained_noise": LEAST * UNEXPLAINED_STEP}}
    )
    trusted, away = object_support(config, readonly(evidence), tracks, cells, side)
    coarse = 2 * side  # distances are told for 2×2 cells of the frame at once

    def distance(positions: Array, x: int, y: int) -> float:
        apart = np.rint(positions) // coarse - (x // 2, y // 2)
        return float(coarse * np.hypot(*apart.T).min())

    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            to_own = distance(own, left + x, top + y)
            to_others = distance(np.concatenate([before, after]), left + x, top + y)
            expected = min(max((to_own - NEAR) / FADE, 0.0), 1.0)
            assert away[y, x] == pytest.approx(expected, abs=0.02 * to_own / FADE + 1e-6)
            if min(abs(to_own - LEARN), abs(to_own - to_others)) > 0.03 * max(to_own, to_others):
                learnt = to_own <= LEARN and to_own < to_others and unexplained[top + y, left + x] >= LEAST
                assert trusted[y, x] == learnt
    assert 0.01 < trusted.mean() < 0.5
