"""The boundary measure F of DAVIS, against its definition written out pixel by pixel."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array
from orchestrator.evaluation.boundary import boundary_f, outline_of
from orchestrator.evaluation.overlap import count_overlap


def slow_boundary(mask: Array) -> list[tuple[int, int]]:
    height, width = mask.shape
    return [
        (y, x)
        for y in range(height)
        for x in range(width)
        if any(
            mask[y, x] != mask[min(y + down, height - 1), min(x + right, width - 1)]
            for down, right in ((0, 1), (1, 0), (1, 1))
        )
    ]


def slow_f(truth: Array, label: Array) -> float:
    reach = math.ceil(0.008 * math.hypot(*truth.shape))
    wanted, found = slow_boundary(truth), slow_boundary(label)
    if not wanted or not found:
        return float(not wanted and not found)

    def share_near(some: list[tuple[int, int]], others: list[tuple[int, int]]) -> float:
        near = [any((y - v) ** 2 + (x - u) ** 2 <= reach**2 for v, u in others) for y, x in some]
        return sum(near) / len(near)

    precision, recall = share_near(found, wanted), share_near(wanted, found)
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def fast_f(truth: Array, label: Array) -> float:
    return boundary_f(outline_of(truth), outline_of(label))


def blobs(seed: int, shape: tuple[int, int]) -> Array:
    noise = np.random.default_rng(seed).normal(size=shape)
    return cv2.GaussianBlur(noise, (0, 0), shape[0] / 12) > 0.01


@pytest.mark.parametrize("shape", [(40, 50), (120, 30), (150, 250)])
@pytest.mark.parametrize("seed", range(3))
def test_f_is_what_the_definition_says(shape: tuple[int, int], seed: int) -> None:
    truth, label = blobs(seed, shape), blobs(seed, shape)
    label[: shape[0] // 2] = blobs(seed + 100, shape)[: shape[0] // 2]
    expected = slow_f(truth, label)
    assert 0.2 < expected < 1
    assert fast_f(truth, label) == pytest.approx(expected, abs=1e-12)


def test_a_boundary_within_reach_is_right_and_one_px_further_is_wrong() -> None:
    # 0.008 × the diagonal of 300×400 px is 4 px.
    from_100, from_104, from_105 = (np.tile(np.arange(400) >= first, (300, 1)) for first in (100, 104, 105))
    assert fast_f(from_100, from_104) == 1
    assert fast_f(from_100, from_105) == 0


def test_nothing_on_both_sides_scores_one_and_on_one_side_zero() -> None:
    nothing, something = np.zeros((20, 20), bool), np.zeros((20, 20), bool)
    something[5:9, 5:9] = True
    assert fast_f(nothing, nothing) == 1
    assert fast_f(nothing, something) == 0
    assert fast_f(something, nothing) == 0


def test_pixels_that_are_not_judged_belong_to_no_region() -> None:
    truth, labels = np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.int32)
    truth[20:40, 20:40], labels[20:40, 20:40] = 1, 7
    labels[:, 60:] = 9
    assert count_overlap(labels, truth).boundary_f < 1
    truth[:, 60:] = 255
    assert count_overlap(labels, truth).boundary_f == 1


def test_every_object_is_compared_with_every_label() -> None:
    truth, labels = np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.int32)
    truth[10:20, 10:20], truth[40:50, 50:70] = 1, 2
    labels[10:20, 10:20], labels[40:50, 50:70] = 8, 5
    overlap = count_overlap(labels, truth)
    assert overlap.labels.tolist() == [5, 8]
    assert overlap.pair_boundary_f.tolist() == [[0, 1], [1, 0]]
