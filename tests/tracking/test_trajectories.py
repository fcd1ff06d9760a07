"""Trajectories: followed to sub-pixel, dropped where they cannot be trusted, seeded where there is room."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from flow_fakes import dense_flow
from scipy.spatial.distance import pdist

from mlbs_actors.config import Config, TrajectoriesConfig, length_scale
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.messages import Array
from mlbs_actors.tracking.density import SQUARE
from mlbs_actors.tracking.seeding import _Ground, _seeds, seed_trajectories
from mlbs_actors.tracking.trajectories import (
    TrajectoryState,
    advance_trajectories,
    empty_trajectories,
    evenly_spread,
    with_residuals,
)

CONFIG = TrajectoriesConfig(history_frames=4)
SHAPE, SIDE = (120, 160), 1
KEPT = 1 - CONFIG.evidence_forgetting
SPACING = CONFIG.seed_spacing_px * length_scale(*SHAPE)


def texture(height: int = 200, width: int = 240, seed: int = 0) -> Array:
    """Smooth random grey texture, float32."""
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.float32)


def shifted(canvas: Array, shift: tuple[float, float]) -> Array:
    """The canvas seen through a frame of SHAPE; its contents move by (x, y) px."""
    mapping = np.array([[1, 0, shift[0] - 40], [0, 1, shift[1] - 40]], np.float64)
    seen = cv2.warpAffine(canvas, mapping, (SHAPE[1], SHAPE[0]), flags=cv2.INTER_CUBIC)
    return np.asarray(np.clip(np.rint(seen), 0, 255), np.uint8)


def flow_between(first: Array, second: Array) -> DenseFlow:
    return dense_flow(first, second, SIDE, Config())


def constant_flow(motion: tuple[float, float]) -> DenseFlow:
    """The same motion everywhere, confirmed everywhere."""
    forward = np.full((*SHAPE, 2), motion, np.float32)
    return DenseFlow(forward, -forward, np.ones(SHAPE, bool), 1, THRESHOLDS)


#: Nothing but flow that leads elsewhere is refused.
THRESHOLDS = (0.01, 0.5, 1e6, 1e6)


def seeded(gray: Array) -> TrajectoryState:
    return seed_trajectories(empty_trajectories(CONFIG), gray, None, SHAPE, SIDE, CONFIG)


def test_a_point_is_followed_to_a_fraction_of_a_pixel() -> None:
    canvas, velocity = texture(), np.array([1.3, -0.7])
    frames = [shifted(canvas, (t * velocity[0], t * velocity[1])) for t in range(11)]
    state = seeded(frames[0])
    start = state
    for before, after in pairwise(frames):
        state, _ = advance_trajectories(state, flow_between(before, after), SHAPE)
    assert len(state) > 0.6 * len(start)
    moved = state.positions - start.positions[np.searchsorted(start.ids, state.ids)]
    error = np.hypot(*(moved - 10 * velocity).T)
    assert (
        np.median(error) < 0.5
    )  # after ten frames: DIS is off by up to 0.03 px a frame, always the same way
    assert np.quantile(error, 0.9) < 0.75
    np.testing.assert_allclose(np.median(state.motions, axis=0), -velocity, atol=0.05)


def test_a_point_that_becomes_hidden_is_dropped_and_one_that_stays_in_view_is_kept() -> None:
    background, thing = texture(seed=1), texture(seed=2)
    frames = []
    for t in range(2):
        frame = shifted(background, (0, 0))
        frame[40:80, 50 + 8 * t : 90 + 8 * t] = thing[:40, :40]
        frames.append(frame)
    state = seeded(frames[0])
    followed, _ = advance_trajectories(state, flow_between(*frames), SHAPE)
    lives = np.isin(state.ids, followed.ids)
    x, y = state.positions.T
    hidden = (x > 91) & (x < 97) & (y > 42) & (y < 78)
    on_thing = (x > 56) & (x < 84) & (y > 46) & (y < 74)
    far = (x < 40) | (x > 115) | (y < 25) | (y > 95)
    assert hidden.sum() >= 5
    assert lives[hidden].mean() < 0.1
    assert lives[on_thing].mean() > 0.9
    assert lives[far].mean() > 0.9


def test_a_point_that_leaves_the_frame_is_dropped() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    followed, _ = advance_trajectories(state, constant_flow((6.0, 0.0)), SHAPE)
    stays = state.positions[:, 0] + 6.0 <= SHAPE[1] - 1
    assert 0 < stays.sum() < len(state)
    np.testing.assert_array_equal(followed.ids, state.ids[stays])
    np.testing.assert_allclose(followed.positions, state.positions[stays] + (6.0, 0.0), atol=1e-4)


def test_a_point_whose_flow_is_not_confirmed_is_dropped() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    flow = constant_flow((0.0, 0.0))
    contradicted = flow.backward.copy()
    contradicted[:, :80] = 9.0
    followed, _ = advance_trajectories(state, replace(flow, backward=contradicted), SHAPE)
    np.testing.assert_array_equal(followed.ids, state.ids[state.positions[:, 0] >= 80])


def test_seeds_keep_their_distance_and_leave_no_gap_in_a_textured_frame() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    assert pdist(state.positions).min() >= 0.75 * SPACING
    inner = (slice(20, -20), slice(20, -20))
    free = np.full(SHAPE, 255, np.uint8)
    x, y = np.rint(state.positions).astype(int).T
    free[y, x] = 0
    gap = cv2.distanceTransform(free, cv2.DIST_L2, 5)[inner]
    assert np.quantile(gap, 0.95) <= 1.5 * SPACING


def squares_of(positions: Array, shape: tuple[int, int], side: int) -> list[tuple[int, int]]:
    """The square of cells that each point is in."""
    pixels = np.clip((positions / side).astype(int), 0, [shape[1] - 1, shape[0] - 1])
    return [(int(y) // SQUARE, int(x) // SQUARE) for x, y in pixels]


def seeds_by_masks(
    positions: Array,
    structure: Array,
    wanted: Array,
    dense: Array,
    shape: tuple[int, int],
    spacings: list[float],
    side: int,
) -> Array:
    """Seeds of two grids: how far each cell is from the nearest point is known, and what a square holds."""
    height, width = shape
    mean, seeds = float(structure.mean()), np.zeros((0, 2), np.float32)
    v, u = np.indices(structure.shape)
    inside = squares_of(positions, structure.shape, side)
    for spacing, chosen in zip(spacings, (wanted, wanted & dense), strict=True):
        cells = (np.concatenate([positions, seeds]) / side).astype(int)
        cells = np.clip(cells, 0, [structure.shape[1] - 1, structure.shape[0] - 1])
        distance = np.full(structure.shape, np.inf)
        for column, row in cells:
            distance = np.minimum(distance, np.hypot(u - column, v - row))
        free = distance >= 0.75 * spacing / side
        rows, columns = int(height / spacing), int(width / spacing)
        found = []
        for row in range(rows):
            for column in range(columns):
                x, y = (np.float32((column + 0.5) * width / columns), np.float32((row + 0.5) * height / rows))
                at = int(y / side), int(x / side)
                border = min(x, y, width - 1 - x, height - 1 - y)
                structured = structure[at] > mean * (0.1 + np.exp(-0.1 * border))
                square = at[0] // SQUARE, at[1] // SQUARE
                if chosen[at] and free[at] and structured and inside.count(square) < CONFIG.square_tracks:
                    found.append((x, y))
                    inside.append(square)
        seeds = np.concatenate([seeds, np.array(found, np.float32).reshape(-1, 2)])
    return seeds


def test_seeds_are_the_points_of_two_grids_that_are_wanted_structured_and_far_from_all_points() -> None:
    rng, shape, side = np.random.default_rng(0), (90, 140), 2
    structure, wanted = rng.random((45, 70)).astype(np.float32), rng.random((45, 70)) > 0.2
    dense = np.zeros((45, 70), bool)
    dense[10:30, 20:60] = True
    positions = (rng.random((25, 2)) * [150, 100] - 5).astype(np.float32)
    expected = seeds_by_masks(positions, structure, wanted, dense, shape, [10.0, 4.5], side)
    advantage = np.where(dense, np.float32(3), np.float32(2))
    ground = _Ground(structure, float(structure.mean()), wanted, advantage, side, CONFIG.square_tracks)
    found = _seeds(positions, ground, 2.0, shape, (10.0, 4.5))
    assert len(found) > 50
    np.testing.assert_array_equal(found, expected)
    inside = squares_of(np.concatenate([positions, found]), structure.shape, side)
    assert max(map(inside.count, inside)) == CONFIG.square_tracks


@pytest.mark.parametrize("shape", [(16, 16), (40, 56), (72, 96)])
def test_a_tiny_frame_has_no_more_trajectories_than_its_pixels_can_tell_apart(shape: tuple[int, int]) -> None:
    gray = np.ascontiguousarray(shifted(texture(), (0, 0))[: shape[0], : shape[1]])
    motion = np.full((*shape, 2), (0.4, 0.3), np.float32)
    flow = DenseFlow(motion, -motion, np.ones(shape, bool), 1, THRESHOLDS)
    state = empty_trajectories(CONFIG)
    for _ in range(12):
        state, _ = advance_trajectories(state, flow, shape)
        state = seed_trajectories(state, gray, flow, shape, SIDE, CONFIG)
        assert 0 < len(state) <= shape[0] * shape[1] / 4


def test_nothing_is_seeded_where_the_image_has_no_structure() -> None:
    gray = shifted(texture(), (0, 0))
    gray[:, 80:] = 128
    state = seeded(gray)
    assert len(state) > 0
    assert state.positions[:, 0].max() < 86
    assert len(seeded(np.full(SHAPE, 77, np.uint8))) == 0


def test_only_the_places_that_trajectories_left_are_seeded_again() -> None:
    gray = shifted(texture(), (0, 0))
    state = seeded(gray)
    still = constant_flow((0.0, 0.0))
    again = seed_trajectories(state, gray, still, SHAPE, SIDE, CONFIG)
    assert len(again) == len(state)
    kept = np.flatnonzero(state.positions[:, 0] < 80)
    contradicted = still.backward.copy()
    contradicted[:, 80:] = 9.0
    half, _ = advance_trajectories(state, replace(still, backward=contradicted), SHAPE)
    np.testing.assert_array_equal(half.ids, state.ids[kept])
    refilled = seed_trajectories(half, gray, still, SHAPE, SIDE, CONFIG)
    fresh = refilled.positions[len(half) :]
    assert len(fresh) > 0.8 * (len(state) - len(half))
    assert fresh[:, 0].min() >= 80 - SPACING
    nearest = np.linalg.norm(fresh[:, None] - half.positions[None], axis=2).min()
    assert nearest >= 0.75 * SPACING - 1.5  # distances are taken between whole pixels


def test_an_id_is_never_given_twice_and_ids_ascend() -> None:
    canvas = texture()
    frames = [shifted(canvas, (5.0 * t, 0.0)) for t in range(5)]
    state = seeded(frames[0])
    ever = state.ids.tolist()
    for before, after in pairwise(frames):
        flow = flow_between(before, after)
        state, _ = advance_trajectories(state, flow, SHAPE)
        survivors = len(state)
        state = seed_trajectories(state, after, flow, SHAPE, SIDE, CONFIG)
        assert (np.diff(state.ids) > 0).all()
        ever += state.ids[survivors:].tolist()
        assert state.next_id == len(ever)
    assert len(ever) > len(seeded(frames[0]))
    assert len(set(ever)) == len(ever)


def test_a_seed_brings_the_motion_that_led_to_it_but_has_none_in_the_first_frame() -> None:
    gray = shifted(texture(), (0, 0))
    first = seeded(gray)
    assert set(first.ages.tolist()) == {0}
    later = seed_trajectories(
        empty_trajectories(CONFIG), gray, constant_flow((2.0, 1.0)), SHAPE, SIDE, CONFIG
    )
    assert set(later.ages.tolist()) == {1}
    np.testing.assert_allclose(later.motions, np.tile((-2.0, -1.0), (len(later), 1)), atol=1e-6)


def test_no_seed_is_set_where_the_flow_that_led_there_is_not_confirmed() -> None:
    gray = shifted(texture(), (0, 0))
    flow = constant_flow((0.0, 0.0))
    confirmed = flow.backward_reliable.copy()
    confirmed[:60] = False
    state = seed_trajectories(
        empty_trajectories(CONFIG), gray, replace(flow, backward_reliable=confirmed), SHAPE, SIDE, CONFIG
    )
    assert len(state) > 0
    assert state.positions[:, 1].min() >= 60


def test_the_newest_residuals_come_first_and_the_oldest_are_forgotten() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    centre = np.argmin(np.linalg.norm(state.positions - (80, 60), axis=1))
    followed_id = state.ids[centre]
    motions = [(1.0, 0.0), (0.0, 2.0), (-1.0, 0.0), (0.5, 0.5), (0.0, -1.0), (0.25, 0.0)]
    expected = np.zeros((4, 2))
    for steps, motion in enumerate(motions, start=1):
        state, _ = advance_trajectories(state, constant_flow(motion), SHAPE)
        predicted = np.full((len(state), 2), 0.5, np.float32)
        state = with_residuals(state, predicted, np.zeros(len(state), np.float32), CONFIG)
        expected = np.concatenate([[-np.array(motion) - 0.5], expected[:-1]])
        row = int(np.flatnonzero(state.ids == followed_id)[0])
        assert state.ages[row] == min(steps, 4)
        np.testing.assert_allclose(state.residuals[row], expected, atol=1e-5)


def test_a_trajectory_without_a_motion_has_no_residual() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    nothing = np.zeros(len(state), np.float32)
    state = with_residuals(state, np.ones((len(state), 2), np.float32), nothing, CONFIG)
    assert not state.residuals.any()


def test_evidence_against_the_camera_adds_up_and_is_slowly_forgotten() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    still = np.zeros((len(state), 2), np.float32)
    expected = np.zeros(len(state))
    for t, advantage in enumerate((3.0, 5.0, -1.5, 0.0, 0.0)):
        own = np.float32(advantage) + np.linspace(-0.4, 0.4, len(state), dtype=np.float32)
        state = with_residuals(state, still, own, CONFIG)
        expected = KEPT * expected + own
        np.testing.assert_allclose(state.evidence, expected, atol=1e-4)
        assert t == 0 or np.ptp(state.evidence) > 0.4
    assert state.evidence.dtype == np.float32
    assert 0.9 < KEPT < 1.0


def test_one_frame_adds_no_more_than_its_bounds_to_the_evidence() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    still = np.zeros((len(state), 2), np.float32)
    least, most = CONFIG.least_evidence_step, CONFIG.most_evidence_step
    assert least < 0 < most
    for advantage, added in ((1000.0, most), (-1000.0, least)):
        judged = with_residuals(state, still, np.full(len(state), advantage, np.float32), CONFIG)
        np.testing.assert_allclose(judged.evidence, added)
        twice = with_residuals(judged, still, np.full(len(state), advantage, np.float32), CONFIG)
        np.testing.assert_allclose(twice.evidence, (1 + KEPT) * added, rtol=1e-5)


def test_evidence_goes_on_with_its_trajectory_and_a_seed_has_none() -> None:
    gray = shifted(texture(), (0, 0))
    state = seeded(gray)
    own = np.linspace(0.0, 5.0, len(state), dtype=np.float32)
    state = with_residuals(state, np.zeros((len(state), 2), np.float32), own, CONFIG)
    flow = constant_flow((6.0, 0.0))
    followed, _ = advance_trajectories(state, flow, SHAPE)
    np.testing.assert_array_equal(followed.evidence, state.evidence[np.isin(state.ids, followed.ids)])
    assert len(followed) < len(state)
    refilled = seed_trajectories(followed, gray, flow, SHAPE, SIDE, CONFIG)
    assert len(refilled) > len(followed)
    assert not refilled.evidence[len(followed) :].any()


def test_where_it_is_dense_more_is_seeded_and_nothing_is_outside() -> None:
    config = TrajectoriesConfig(history_frames=4, seed_spacing_px=32.0, dense_spacing_px=10.0)
    gray = shifted(texture(), (0, 0))
    flow = constant_flow((0.0, 0.0))
    dense = np.zeros(SHAPE, bool)
    dense[30:90, 40:110] = True
    advantage = np.where(dense, np.float32(2 * config.dense_advantage), np.float32(0))
    state = seed_trajectories(empty_trajectories(config), gray, flow, SHAPE, SIDE, config)
    more = seed_trajectories(state, gray, flow, SHAPE, SIDE, config, advantage)
    np.testing.assert_array_equal(more.ids[: len(state)], state.ids)
    fresh = more.positions[len(state) :]
    x, y = np.rint(fresh).astype(int).T
    assert dense[y, x].all()

    def count(positions: Array) -> int:
        columns, rows = np.rint(positions).astype(int).T
        return int(dense[rows, columns].sum())

    coarse = count(state.positions)
    assert count(more.positions) > 5 * coarse  # a full grid alone has ten times as many
    alone = seed_trajectories(empty_trajectories(config), gray, flow, SHAPE, SIDE, config, advantage)
    assert count(alone.positions) > 5 * coarse
    np.testing.assert_array_equal(alone.positions, more.positions)
    spacing = config.dense_spacing_px * length_scale(*SHAPE)
    assert pdist(more.positions).min() >= 0.75 * spacing - 0.8  # distances are taken between whole pixels
    nowhere = seed_trajectories(state, gray, flow, SHAPE, SIDE, config, np.zeros(SHAPE, np.float32))
    assert len(nowhere) == len(state)


def test_nothing_to_follow_stays_nothing() -> None:
    state, _ = advance_trajectories(empty_trajectories(CONFIG), constant_flow((1.0, 1.0)), SHAPE)
    assert len(state) == 0
    none = np.zeros((0, 2), np.float32)
    assert with_residuals(state, none, none[:, 0], CONFIG).residuals.shape == (0, 4, 2)


def test_of_each_square_the_first_of_the_chosen_points_is_picked() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 100, (200, 2)).astype(np.float32)
    chosen = rng.random(200) < 0.7
    first: dict[tuple[int, int], int] = {}
    for point in np.flatnonzero(chosen):
        x, y = positions[point] // np.float32(12.5)
        first.setdefault((int(x), int(y)), int(point))
    assert evenly_spread(positions, chosen, 12.5).tolist() == sorted(first.values())
    assert len(evenly_spread(positions, np.zeros(200, bool), 12.5)) == 0


def test_who_lives_on_is_told_by_the_place_before() -> None:
    state = seeded(shifted(texture(), (0, 0)))
    flow = constant_flow((6.0, -3.0))
    followed, survivors = advance_trajectories(state, flow, SHAPE)
    assert 0 < len(followed) < len(state)
    np.testing.assert_array_equal(followed.ids, state.ids[survivors])
    np.testing.assert_allclose(followed.positions, state.positions[survivors] + (6, -3), atol=1e-4)
    np.testing.assert_allclose(followed.motions, np.tile((-6, 3), (len(followed), 1)), atol=1e-4)
