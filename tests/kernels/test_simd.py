"""Numbers side by side, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.kernels.simd import (
    absolute,
    broadcast,
    broadcast_lane,
    exp2_of_whole,
    gathered,
    load,
    load_int32,
    maximum,
    minimum,
    multiply_add,
    rounded,
    shifted,
    square_root,
    store,
    sum_of_lanes,
    truncated,
    where_equal,
)
from mlbs_actors.messages import Array


@compiled
def _of_sixteen(values: Array, result: Array) -> None:
    one, other = load(values, np.uint64(1), 16), load(values, np.uint64(4), 16)
    store(result, np.uint64(0), one + other)
    store(result, np.uint64(16), one - other)
    store(result, np.uint64(32), one * other)
    store(result, np.uint64(48), one / other)
    store(result, np.uint64(64), square_root(absolute(one)) + broadcast(np.float32(0.1), 16))
    store(result, np.uint64(80), maximum(one, other))
    store(result, np.uint64(96), minimum(one, other))
    store(result, np.uint64(112), truncated(one))
    store(result, np.uint64(128), rounded(one))
    store(result, np.uint64(144), exp2_of_whole(truncated(one)))


@compiled
def _between_lanes(values: Array, result: Array) -> np.float32:
    one, other = load(values, np.uint64(0), 16), load(values, np.uint64(16), 16)
    store(result, np.uint64(0), shifted(one, other, 5))
    store(result, np.uint64(16), broadcast_lane(other, 3))
    together: np.float32 = sum_of_lanes(one)
    return together


@compiled
def _of_eight_bytes(values: Array, result: Array) -> None:
    store(result, np.uint64(2), load(values, np.uint64(3), 8) / broadcast(np.float32(3), 8))


def test_operations_are_those_on_single_numbers() -> None:
    values = np.random.default_rng(0).normal(0, 10, 20).astype(np.float32)
    values[[2, 5]] = 0.5, -2.5  # halves are rounded to the even number
    one, other = values[1:17], values[4:20]
    result = np.zeros(160, np.float32)
    _of_sixteen(values, result)
    expected = [one + other, one - other, one * other, one / other]
    expected += [np.sqrt(abs(one)) + np.float32(0.1), np.maximum(one, other), np.minimum(one, other)]
    expected += [np.trunc(one), np.rint(one), np.exp2(np.trunc(one))]
    np.testing.assert_array_equal(result, np.concatenate(expected))


def test_lanes_are_moved_and_added() -> None:
    values, result = np.random.default_rng(1).normal(0, 10, 32).astype(np.float32), np.zeros(32, np.float32)
    by_fours = values[:16].reshape(4, 4)
    one, two, three, four = by_fours[0] + by_fours[1] + by_fours[2] + by_fours[3]
    assert _between_lanes(values, result) == (one + two) + (three + four)
    np.testing.assert_array_equal(result[:16], values[5:21])
    assert (result[16:] == values[19]).all()


@pytest.mark.parametrize("most", [1, 255])
def test_bytes_become_numbers_and_nothing_beside_is_written(most: int) -> None:
    values = np.random.default_rng(0).integers(0, most, 11, np.uint8, endpoint=True)
    result = np.zeros(12, np.float32)
    _of_eight_bytes(values, result)
    np.testing.assert_array_equal(result[2:10], values[3:].astype(np.float32) / np.float32(3))
    assert not result[[0, 1, 10, 11]].any()


@compiled
def _sums_of_whole_numbers(shorts: Array, bytes_: Array) -> tuple[int, int, int]:
    one, other = load_int32(shorts, np.uint64(1), 8), load_int32(bytes_, np.uint64(2), 8)
    return sum_of_lanes(one * other), sum_of_lanes(one + other), sum_of_lanes(one - broadcast(np.int32(3), 8))


def test_whole_numbers_are_summed_exactly() -> None:
    rng = np.random.default_rng(0)
    shorts, bytes_ = rng.integers(-32768, 32768, 9, np.int16), rng.integers(0, 256, 10, np.uint8)
    one, other = shorts[1:].astype(int), bytes_[2:].astype(int)
    expected = ((one * other).sum(), (one + other).sum(), (one - 3).sum())
    assert _sums_of_whole_numbers(shorts, bytes_) == expected


@compiled
def _product_and_third(numbers: Array, shorts: Array, result: Array) -> None:
    one, other = load(numbers, np.uint64(0), 8), load(shorts, np.uint64(1), 8)
    store(result, np.uint64(0), multiply_add(one, other, one))


def test_a_product_and_a_third_number_are_added_with_the_error_of_one_or_two_roundings() -> None:
    rng = np.random.default_rng(0)
    numbers, result = rng.normal(0, 10, 8).astype(np.float32), np.empty(8, np.float32)
    shorts = rng.integers(-32768, 32768, 9, np.int16)
    _product_and_third(numbers, shorts, result)
    exact = numbers.astype(float) * (shorts[1:].astype(float) + 1)
    np.testing.assert_allclose(result, exact, rtol=3e-7)


@compiled
def _gathered_and_chosen(numbers: Array, places: Array, result: Array) -> None:
    found = gathered(numbers, load_int32(places, np.uint64(1), 8))
    store(result, np.uint64(0), found)
    seven, none = broadcast(np.int32(7), 8), broadcast(np.int32(0), 8)
    store(result, np.uint64(8), where_equal(found, seven, found * found, none - found))


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.int64])
def test_numbers_are_gathered_and_chosen_by_what_is_equal(kind: type) -> None:
    rng = np.random.default_rng(0)
    numbers: Array = rng.integers(-9, 10, 50).astype(kind)
    places: Array = rng.integers(0, 50, 9).astype(np.int32)
    numbers[places[3]] = 7
    result = np.zeros(16, np.int32)
    _gathered_and_chosen(numbers, places, result)
    found = numbers[places[1:]]
    np.testing.assert_array_equal(result[:8], found)
    np.testing.assert_array_equal(result[8:], np.where(found == 7, found**2, -found))
