"""Dense flow: known translations, the size of its grid, and its checks against plain loops."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from flow_fakes import dense_flow, flow_gray

from mlbs_actors.cells import mean_of_cells
from mlbs_actors.config import Config
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.consistency import DenseFlow, reliable_at
from mlbs_actors.flow.estimate import FlowEstimator, gray_levels, picture_of
from mlbs_actors.messages import Array, Region

CONFIG = Config()
CHECKS = CONFIG.trajectories


def texture(height: int, width: int, seed: int = 0) -> Array:
    """Smooth random grey texture, uint8."""
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.uint8)


def covered_scene() -> tuple[Array, Array, Array]:
    """Two grey frames in which a square moves 8 px to the right, and the square's place in the first."""
    background, thing = texture(96, 128, 1), texture(32, 32, 2)
    square = np.zeros((96, 128), bool)
    square[32:64, 40:72] = True
    first, second = background.copy(), background.copy()
    first[32:64, 40:72] = thing
    second[32:64, 48:80] = thing
    return first, second, square


def test_a_pan_is_found_in_both_directions() -> None:
    canvas = texture(120, 160)
    first = np.ascontiguousarray(canvas[10:106, 10:138])
    second = np.ascontiguousarray(canvas[12:108, 7:135])  # things move by (+3, −2)
    flow = dense_flow(first, second, 1, CONFIG)
    inner = np.s_[12:-12, 12:-12]
    np.testing.assert_allclose(np.median(flow.forward[inner], axis=(0, 1)), [3, -2], atol=0.05)
    np.testing.assert_allclose(np.median(flow.backward[inner], axis=(0, 1)), [-3, 2], atol=0.05)
    assert flow.forward_reliable()[inner].mean() > 0.99
    assert flow.backward_reliable[inner].mean() > 0.99


def test_flow_of_cells_is_stated_in_px() -> None:
    canvas = cv2.resize(texture(120, 160), (480, 360), interpolation=cv2.INTER_CUBIC)  # ×3
    first, second = canvas[30:318, 30:414], canvas[26:314, 36:420]  # things move by (−6, +4)
    cells = [mean_of_cells(one, 3) for one in (first, second)]
    flow = dense_flow(cells[0], cells[1], 3, CONFIG)
    assert flow.side == 3
    inner = np.s_[12:-12, 12:-12]
    np.testing.assert_allclose(np.median(flow.forward[inner], axis=(0, 1)), [-6, 4], atol=0.2)


def test_inside_a_box_of_the_focus_the_flow_is_nearly_the_finest_and_outside_it_is_the_next_coarser() -> None:
    first, second, _ = covered_scene()
    box = Region(24, 16, 72, 64)
    finest = dense_flow(first, second, 1, CONFIG)
    found = dense_flow(first, second, 1, CONFIG, [box])
    coarser = dense_flow(first, second, 1, CONFIG, [])
    inner = np.s_[24:72, 32:88]  # away from the box's own border
    missed = np.hypot(*np.moveaxis(found.backward - finest.backward, 2, 0))[inner]
    missed_without = np.hypot(*np.moveaxis(coarser.backward - finest.backward, 2, 0))[inner]
    assert np.median(missed) < 0.05
    assert missed.mean() < 0.5 * missed_without.mean()
    outside = np.ones(first.shape, bool)
    outside[box.slices] = False
    np.testing.assert_array_equal(found.backward[outside], coarser.backward[outside])
    missed = np.hypot(*np.moveaxis(found.forward - finest.forward, 2, 0))[inner]
    assert np.median(missed) < 0.05


def test_outside_the_boxes_the_forward_flow_is_the_backward_flow_turned_around() -> None:
    canvas = texture(120, 160)
    first = np.ascontiguousarray(canvas[10:106, 10:138])
    second = np.ascontiguousarray(canvas[12:108, 7:135])
    flow = dense_flow(first, second, 1, CONFIG, [])
    for y in range(12, 84, 7):
        for x in range(12, 116, 7):
            u, v = flow.forward[y, x]
            # To the pixel in which the point comes to lie, where this flow changes little.
            back = flow.backward[y + round(float(v)), x + round(float(u))]
            np.testing.assert_allclose((u, v), -back, atol=0.1)
    np.testing.assert_allclose(np.median(flow.forward[12:-12, 12:-12], axis=(0, 1)), [3, -2], atol=0.1)


def test_what_is_covered_or_uncovered_is_not_reliable() -> None:
    first, second, square = covered_scene()
    flow = dense_flow(first, second, 1, CONFIG)
    covered = np.zeros_like(square)
    covered[32:64, 72:80] = True  # background in the first frame, behind the square in the second
    uncovered = np.zeros_like(square)
    uncovered[32:64, 40:48] = True
    assert flow.forward_reliable()[covered].mean() < 0.1
    assert flow.backward_reliable[uncovered].mean() < 0.1
    far = cv2.dilate((square | covered).astype(np.uint8), np.ones((25, 25), np.uint8)) == 0
    assert flow.forward_reliable()[far].mean() > 0.9
    assert flow.forward_reliable()[40:56, 48:64].mean() > 0.9  # the inside of the square


def reference_checks(flow: DenseFlow) -> tuple[Array, Array]:
    """Forward reliability by loops, and where it is not decided by the last digits."""
    height, width = flow.forward.shape[:2]
    reliable, clear = np.zeros((height, width), bool), np.zeros((height, width), bool)
    padded = np.pad(flow.forward.astype(np.float64), ((1, 1), (1, 1), (0, 0)), mode="reflect")
    for y in range(height):
        for x in range(width):
            w = flow.forward[y, x].astype(np.float64)
            there_x, there_y = x + w[0] / flow.side, y + w[1] / flow.side
            inside = min(there_x, there_y, width - 1 - there_x, height - 1 - there_y)
            if inside < 1e-4:
                clear[y, x] = inside < -1e-4
                continue
            left, top = min(int(there_x), width - 2), min(int(there_y), height - 2)
            right, down = there_x - left, there_y - top
            corners = flow.backward[top : top + 2, left : left + 2].astype(np.float64)
            back = (1 - down) * ((1 - right) * corners[0, 0] + right * corners[0, 1]) + down * (
                (1 - right) * corners[1, 0] + right * corners[1, 1]
            )
            error = np.sum((w + back) ** 2)
            allowed = CHECKS.consistency_relative * (np.sum(w**2) + np.sum(back**2)) + CHECKS.consistency_px2
            window = padded[y : y + 3, x : x + 3]
            weights = np.array([3.0, 10.0, 3.0]) / 32
            horizontal = np.tensordot(weights, window[:, 2] - window[:, 0], 1) / flow.side
            vertical = np.tensordot(weights, window[2] - window[0], 1) / flow.side
            gradient = np.sum(horizontal**2) + np.sum(vertical**2)
            bound = CHECKS.boundary_relative * np.sum(w**2) + CHECKS.boundary_absolute
            reliable[y, x] = error < allowed and gradient <= bound
            # OpenCV interpolates at 1/32 px.
            rounding = np.abs(np.diff(corners, axis=0)).sum() + np.abs(np.diff(corners, axis=1)).sum()
            doubt = 2 * np.sqrt(error + allowed) * rounding / 32 + 1e-5
            clear[y, x] = abs(error - allowed) > doubt and abs(gradient - bound) > 1e-5
    return reliable, clear


@pytest.mark.parametrize("side", [1, 3])
def test_the_checks_are_those_of_plain_loops(side: int) -> None:
    first, second, _ = covered_scene()
    flow = dense_flow(first, second, side, CONFIG)
    reliable, clear = reference_checks(flow)
    assert clear.mean() > 0.9
    assert reliable[clear].any()
    assert not reliable[clear].all()
    np.testing.assert_array_equal(flow.forward_reliable()[clear], reliable[clear])


@pytest.mark.parametrize("side", [1, 3])
def test_the_checks_at_some_places_are_those_of_the_whole_field(side: int) -> None:
    first, second, _ = covered_scene()
    flow = dense_flow(first, second, side, CONFIG)
    y, x = (one.ravel() for one in np.indices(first.shape))
    found = reliable_at(flow.forward, flow.backward, flow.side, flow.thresholds, x, y)
    np.testing.assert_array_equal(found, flow.forward_reliable().ravel())
    assert 0 < found.mean() < 1


def test_a_grey_value_is_that_of_the_colour() -> None:
    frame = np.full((32, 48, 3), (10, 200, 90), np.uint8)
    assert set(np.unique(flow_gray(frame, 2))) == {round(0.114 * 10 + 0.587 * 200 + 0.299 * 90)}


# Other ways to come by a flow


def moving_square() -> tuple[Array, Array, Array]:
    """Two frames in which a square moves by (8, 0) on a ground that stands, and where it is in the first."""
    first, second, square = covered_scene()
    return cv2.cvtColor(first, cv2.COLOR_GRAY2BGR), cv2.cvtColor(second, cv2.COLOR_GRAY2BGR), square


def test_opencvs_search_finds_the_same_motion() -> None:
    first, second, _ = moving_square()
    config = Config.model_validate({"flow": {"method": "opencv"}})
    flow = FlowEstimator(config).between(picture_of(first, 1, False), picture_of(second, 1, False), 1)
    np.testing.assert_allclose(np.median(flow.forward[38:58, 46:66], axis=(0, 1)), [8, 0], atol=0.3)
    np.testing.assert_allclose(np.median(flow.forward[:20], axis=(0, 1)), [0, 0], atol=0.1)
    assert flow.backward_reliable.mean() > 0.7


@pytest.mark.parametrize("side", [1, 2, 3])
def test_a_callers_flow_is_asked_for_both_directions_and_averaged_over_cells(side: int) -> None:
    first, second, _ = moving_square()
    asked = []

    def flow(one: Array, other: Array) -> Array:
        asked.append((one[0, 0, 0], other[0, 0, 0]))
        motion = np.zeros((*one.shape[:2], 2))
        motion[:, 64:] = (6.0, -2.0) if len(asked) == 1 else (-6.0, 2.0)
        return motion

    pictures = picture_of(first, side, True), picture_of(second, side, True)
    found = FlowEstimator(CONFIG, flow).between(*pictures, side)
    assert asked == [(first[0, 0, 0], second[0, 0, 0]), (second[0, 0, 0], first[0, 0, 0])]
    assert found.forward.shape == (-(-96 // side), -(-128 // side), 2)
    np.testing.assert_allclose(found.forward[5, -5], [6, -2])
    np.testing.assert_allclose(found.backward[5, -5], [-6, 2])
    np.testing.assert_allclose(found.backward[5, 5], [0, 0])
    assert found.backward_reliable[5, 5]


@pytest.mark.parametrize(
    ("returned", "complaint"),
    [
        (np.zeros((96, 128), np.float32), "must return the motion"),
        (np.zeros((96, 128, 2), int), "must return the motion"),
        (np.full((96, 128, 2), np.nan), "NaN"),
        (None, "returned None; it must return the motion"),
        ([[1.0], []], "returned a list of 2; it must return the motion"),
    ],
)
def test_what_is_no_flow_is_refused_in_a_sentence(returned: Any, complaint: str) -> None:
    pictures = [picture_of(one, 1, True) for one in moving_square()[:2]]
    with pytest.raises(FrameError, match=complaint):
        FlowEstimator(CONFIG, lambda *_: returned).between(pictures[0], pictures[1], 1)


@pytest.mark.parametrize("colour", [(60, 70, 185), (200, 90, 60)], ids=["red", "blue"])
def test_in_a_large_frame_a_colour_as_bright_as_its_ground_stands_out(colour: tuple[int, int, int]) -> None:
    pixels = np.array([[colour]], np.uint8)
    brightness = gray_levels(pixels, (480, 640))
    ground = np.full_like(pixels, brightness)
    assert gray_levels(ground, (480, 640)) == brightness
    assert gray_levels(pixels, (1080, 1920)).astype(int) - gray_levels(ground, (1080, 1920)) > 30
