"""How many trajectories a square takes, and which of those that are too many stay."""

from __future__ import annotations

import numpy as np
import pytest
from flow_fakes import dense_flow, flow_gray

from mlbs_actors.config import Config
from mlbs_actors.footage.fixed import FixedState
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.tracking.density import SQUARE, room_left, within_room
from mlbs_actors.tracking.tracker import Transition, track
from mlbs_actors.tracking.trajectories import empty_trajectories

SHAPE, SIDE, OLDEST, MOST = (37, 50), 2, 24, 7


def crowded(seed: int) -> tuple[Array, Array]:
    """Positions, some of them outside, and ages of trajectories, most of them in one corner."""
    rng = np.random.default_rng(seed)
    spread = np.where(rng.random((400, 1)) < 0.7, 0.3, 1.1)
    positions = (rng.random((400, 2)) * spread * [100, 74] - 2).astype(np.float32)
    return positions, rng.integers(OLDEST - 3, OLDEST + 1, 400).astype(np.int32)


def square_of(position: Array) -> tuple[int, int]:
    column, row = np.clip((position / SIDE).astype(int), 0, [SHAPE[1] - 1, SHAPE[0] - 1])
    return int(row) // SQUARE, int(column) // SQUARE


def test_the_young_stay_and_of_the_oldest_as_many_of_the_first_as_a_square_takes() -> None:
    positions, ages = crowded(0)
    inside: list[tuple[int, int]] = []
    expected = []
    for point, (position, age) in enumerate(zip(positions, ages, strict=True)):
        if age < OLDEST:
            expected.append(point)
        elif inside.count(square_of(position)) < MOST:
            inside.append(square_of(position))
            expected.append(point)
    assert len(expected) < 390
    np.testing.assert_array_equal(within_room(positions, ages, OLDEST, SHAPE, SIDE, MOST), expected)


def test_room_is_what_a_square_takes_less_all_that_are_in_it() -> None:
    positions, _ = crowded(1)
    inside = [square_of(position) for position in positions]
    room = room_left(positions, SHAPE, SIDE, MOST)
    assert room.shape == (5, 7)
    for square in np.ndindex(room.shape):
        assert room[square] == MOST - inside.count(square)


@pytest.mark.long
def test_trajectories_of_an_object_that_is_watched_for_long_do_not_pile_up() -> None:
    config, shape, side = Config(), (240, 320), 1
    stage = scene("steady-crowd", frames=60, width=shape[1], height=shape[0], objects=1)
    grays = [flow_gray(stage.frame(index), side) for index in range(60)]
    fixed, none = FixedState.beginning(grays[0]), empty_trajectories(config.trajectories)
    state = track(none, np.zeros(0, bool), fixed, None, grays[0], shape, config).trajectories
    for index in range(1, 180):  # forth, back and forth
        before, gray = (grays[59 - abs(59 - (at % 118))] for at in (index - 1, index))
        transition = Transition(before, dense_flow(before, gray, side, config))
        known = np.ones(len(state), bool)
        tracked = track(state, known, fixed, transition, gray, shape, config)
        state, fixed = tracked.trajectories, tracked.fixed
        old = state.positions[state.ages == config.trajectories.history_frames]
        assert (room_left(old, gray.shape, side, config.trajectories.square_tracks) >= 0).all()
