"""The camera's motion: recovered under outliers, and the image it fails to explain."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.geometry.homography import homography_motion, homography_of_cells
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import _differences, _median_error, camera_evidence, camera_homography

#: A roll of 2°, a zoom of 3 %, a shift and a little perspective.
TRUE = np.array([[1.029, -0.036, 6.0], [0.036, 1.029, -4.0], [2e-5, -1e-5, 1.0]])
CONFIG = TrajectoriesConfig()
CORNERS = np.array([[0, 0], [639, 0], [0, 479], [639, 479], [320, 240]], np.float32)


def points(count: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform((0, 0), (639, 479), (count, 2)).astype(np.float32)


def texture(height: int, width: int) -> Array:
    noise = np.random.default_rng(3).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.uint8)


@pytest.mark.parametrize("side", [1, 2, 5])
def test_the_homography_of_cells_takes_them_where_it_takes_their_centres(side: int) -> None:
    places = points(50).astype(np.float64)
    cells = (places + 0.5) / side - 0.5
    moved = cv2.perspectiveTransform(cells[None], homography_of_cells(TRUE, side))[0]
    expected = cv2.perspectiveTransform(places[None], TRUE)[0]
    np.testing.assert_allclose((moved + 0.5) * side - 0.5, expected, atol=1e-9)


def unmoving(shape: tuple[int, ...]) -> Array:
    return np.zeros((*shape, 2), np.float32)


def unexplained(previous: Array, current: Array, matrix: Array, side: int) -> Array:
    return camera_evidence(previous, current, matrix, unmoving(current.shape), side, CONFIG).unexplained


def translation(x: float, y: float) -> Array:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]], np.float64)


def test_the_motion_of_a_homography_is_that_of_plain_loops() -> None:
    positions = points(30)
    motion = homography_motion(TRUE, positions)
    for (x, y), moved in zip(positions.astype(float), motion, strict=True):
        u, v, w = TRUE @ (x, y, 1.0)
        np.testing.assert_allclose(moved, (u / w - x, v / w - y), atol=1e-4)


def test_the_homography_is_recovered_although_a_third_of_the_points_move_on_their_own() -> None:
    positions = points(300)
    motions = homography_motion(TRUE, positions)
    motions += np.random.default_rng(1).normal(0, 0.1, motions.shape).astype(np.float32)
    motions[:100] += np.array([12.0, 5.0], np.float32)
    found = camera_homography(positions, motions, 1.0, CONFIG)
    error = homography_motion(found, CORNERS) - homography_motion(TRUE, CORNERS)
    assert np.abs(error).max() < 0.3


def test_equal_points_give_equal_bytes() -> None:
    positions = points(200)
    motions = homography_motion(TRUE, positions)
    motions[::3] += np.random.default_rng(2).normal(0, 20, motions[::3].shape).astype(np.float32)
    cv2.setRNGSeed(1)
    one = camera_homography(positions, motions, 1.0, CONFIG)
    cv2.setRNGSeed(99)
    other = camera_homography(positions.copy(), motions.copy(), 1.0, CONFIG)
    assert one.tobytes() == other.tobytes()


def test_few_points_give_their_median_translation() -> None:
    motions = np.array([[3, 1], [3, 1], [4, 2], [90, -70], [2, 0]], np.float32)
    np.testing.assert_array_equal(camera_homography(points(5), motions, 1.0, CONFIG), translation(3, 1))


def test_no_points_give_the_identity() -> None:
    none = np.zeros((0, 2), np.float32)
    np.testing.assert_array_equal(camera_homography(none, none, 1.0, CONFIG), np.eye(3))
    assert homography_motion(np.eye(3), none).shape == (0, 2)


@pytest.mark.parametrize("arrangement", ["one place", "one line", "folded"])
def test_points_that_determine_no_homography_give_one_that_is_still_sane(arrangement: str) -> None:
    positions = points(40)
    motions = np.tile(np.array([2.0, -1.0], np.float32), (40, 1))
    if arrangement == "one place":
        positions[:] = (50.0, 60.0)
    elif arrangement == "one line":
        positions = np.stack([positions[:, 0], 0.5 * positions[:, 0]], axis=1).astype(np.float32)
    else:  # mirrored: no camera does that
        motions[:, 0] = 639 - 2 * positions[:, 0]
    found = camera_homography(positions, motions, 1.0, CONFIG)
    assert np.isfinite(found).all()
    assert 0.5 < np.linalg.det(found[:2, :2]) < 2.0
    if arrangement != "folded":
        np.testing.assert_allclose(homography_motion(found, positions), motions, atol=0.5)


@pytest.mark.parametrize("side", [1, 2, 4])
def test_a_pure_pan_is_explained_altogether(side: int) -> None:
    canvas = texture(140, 180)
    previous, current = canvas[10:130, 10:170].copy(), canvas[13:133, 6:166].copy()  # it moves by (+4, −3)
    camera = translation(-4 * side, 3 * side)  # back to the frame before, full-size px
    difference = unexplained(previous, current, camera, side)
    assert difference.dtype == np.float32
    assert difference.shape == current.shape
    assert difference.max() == 0.0
    assert (unexplained(previous, current, np.eye(3), side) > 0).mean() > 0.95


def test_under_a_rolling_camera_only_what_moves_on_its_own_stands_out() -> None:
    previous = texture(240, 320)
    roll = np.array([[np.cos(0.05), -np.sin(0.05), 9.0], [np.sin(0.05), np.cos(0.05), -5.0], [0, 0, 1]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    current = np.asarray(cv2.warpPerspective(previous, roll, (320, 240), flags=flags))
    current[100:130, 140:180] = texture(300, 400)[260:290, 340:380]

    def contrast(camera: Array) -> float:
        difference = unexplained(previous, current, camera, 1)
        elsewhere = np.concatenate([difference[30:90, 30:-30], difference[140:-30, 30:-30]])
        return float(difference[102:128, 142:178].mean() / elsewhere.mean())

    assert contrast(roll) > 5.0
    assert contrast(np.eye(3)) < 2.0


def test_what_moves_on_its_own_is_unexplained_and_nothing_else_is() -> None:
    canvas = texture(140, 180)
    previous, current = canvas[10:130, 10:170].copy(), canvas[10:130, 6:166].copy()
    thing = texture(200, 200)[150:180, 150:180]
    previous[40:70, 60:90] = thing
    current[50:80, 60:90] = thing
    difference = unexplained(previous, current, translation(-4, 0), 1)
    touched = np.zeros(difference.shape, bool)
    touched[38:82, 56:98] = True  # the thing now, the thing then as the camera moved it, and the window
    assert (difference[52:78, 62:88] > 0).all()
    assert difference[~touched].max() == 0.0


@pytest.mark.parametrize(
    "mapping",
    [
        np.eye(3),
        np.array([[1, 0, 3.5], [0, 1, -2.25], [0, 0, 1]]),
        np.array([[0.99, 0.02, 1.0], [-0.01, 1.01, 0.5], [1e-4, -2e-4, 1]]),
        np.array([[1.0, 0, 100], [0, 1, 0], [0, 0, 1]]),
    ],
)
def test_frames_differ_where_the_mapping_does_not_lead_out(mapping: Array) -> None:
    current, one, other = np.random.default_rng(0).integers(0, 256, (3, 20, 30)).astype(np.uint8)
    y, x = np.mgrid[:20, :30]
    there_x, there_y, scale = np.tensordot(mapping, np.stack([x, y, np.ones_like(x)]), 1)
    inside = (there_x >= 0) & (there_x <= 29 * scale) & (there_y >= 0) & (there_y <= 19 * scale)
    for found, moved in zip(_differences(current, one, other, mapping), (one, other), strict=True):
        expected = np.abs(current.astype(int) - moved) * inside
        np.testing.assert_array_equal(found, expected)


def test_the_difference_is_the_mean_over_a_window() -> None:
    previous = np.zeros((21, 21), np.uint8)
    current = previous.copy()
    current[10, 10] = 100
    difference = unexplained(previous, current, np.eye(3), 1)
    window = np.zeros((21, 21))
    window[8:13, 8:13] = 1
    assert difference.max() > 0
    np.testing.assert_allclose(difference, window * difference.max(), atol=1e-5)
    current[10, 10] = 50
    halved = unexplained(previous, current, np.eye(3), 1)
    np.testing.assert_allclose(halved, 0.5 * difference, atol=1e-5)


def test_where_the_frame_before_did_not_reach_nothing_is_unexplained() -> None:
    previous, current = np.full((60, 80), 200, np.uint8), np.full((60, 80), 20, np.uint8)
    difference = unexplained(previous, current, translation(-30, 0), 1)
    assert difference[:, :27].max() == 0.0  # the 30 px that came into view, without the window's reach
    assert difference[:, 34:].min() > 0.0


# What the flow explains better


def moving_thing(ground: Array, thing: Array) -> tuple[Array, Array, Array]:
    """A thing moves by (6, 0) on a ground that stands: two frames, and its flow, bled far past it."""
    previous, current = ground.copy(), ground.copy()
    previous[40:80, 50:90], current[40:80, 56:96] = thing[:40, :40], thing[:40, :40]
    flow = np.zeros((*ground.shape, 2), np.float32)
    flow[20:100, 30:130] = (-6.0, 0.0)
    return previous, current, flow


def test_the_flow_of_a_textured_thing_explains_it_better_than_the_camera() -> None:
    previous, current, flow = moving_thing(texture(120, 160), texture(200, 300)[150:, 150:])
    found = camera_evidence(previous, current, np.eye(3), flow, 1, CONFIG)
    assert found.advantage.dtype == np.float32
    inner = np.s_[43:77, 59:93]
    assert (found.advantage[inner] > 0).all()
    np.testing.assert_allclose(found.advantage[inner], found.unexplained[inner], atol=1e-5)
    assert np.abs(found.advantage[:17]).max() == 0.0


def test_flow_that_bled_over_smooth_ground_explains_it_no_better() -> None:
    smooth = np.full((120, 160), 90, np.uint8)
    previous, current, flow = moving_thing(smooth, texture(200, 300)[150:, 150:])
    advantage = camera_evidence(previous, current, np.eye(3), flow, 1, CONFIG).advantage
    around = np.zeros(smooth.shape, bool)
    around[20:100, 30:130] = True
    around[37:83, 42:106] = False  # the thing then and now, and the window
    assert np.abs(advantage[around]).max() == 0.0
    assert advantage[43:77, 59:93].min() > 0.0
    drawn = np.random.default_rng(0).normal(0, 5, flow.shape).astype(np.float32)
    flat = camera_evidence(smooth, smooth, np.eye(3), drawn, 1, CONFIG).advantage
    assert np.abs(flat).max() == 0.0


def test_flow_that_bled_over_textured_ground_speaks_for_the_camera() -> None:
    previous, current, flow = moving_thing(texture(120, 160), texture(200, 300)[150:, 150:])
    advantage = camera_evidence(previous, current, np.eye(3), flow, 1, CONFIG).advantage
    assert advantage[22:36, 32:128].mean() < -1.0


@pytest.mark.parametrize("side", [1, 2, 4])
def test_the_flow_is_stated_in_px(side: int) -> None:
    canvas = texture(140, 180)
    previous, current = canvas[10:130, 10:170].copy(), canvas[13:133, 6:166].copy()  # it moves by (+4, −3)
    flow = np.full((*current.shape, 2), (-4 * side, 3 * side), np.float32)
    found = camera_evidence(previous, current, np.eye(3), flow, side, CONFIG)
    inner = np.s_[6:-6, 6:-6]
    np.testing.assert_allclose(found.advantage[inner], found.unexplained[inner], atol=1e-5)
    assert found.advantage[inner].mean() > 1.0


def test_where_the_frame_before_did_not_reach_nothing_is_better_explained() -> None:
    previous, current = np.full((60, 80), 200, np.uint8), np.full((60, 80), 20, np.uint8)
    still = unmoving(current.shape)
    advantage = camera_evidence(previous, current, translation(-30, 0), still, 1, CONFIG).advantage
    assert np.abs(advantage[:, :27]).max() == 0.0


@pytest.mark.parametrize("shape", [(12, 14), (11, 13), (5, 5), (9, 2)])
def test_the_noise_is_the_median_of_every_fourth_error(shape: tuple[int, int]) -> None:
    difference = np.random.default_rng(sum(shape)).integers(0, 256, shape).astype(np.uint8)
    error = cv2.boxFilter(difference, cv2.CV_32F, (5, 5))
    assert _median_error(error) == pytest.approx(float(np.median(error[::2, ::2])), abs=1e-5)
