"""Numbers side by side, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.kernels.simd import (
    absolute,
    broadcast,
    exp2_of_whole,
    load,
    maximum,
    minimum,
    multiply_add,
    rounded,
    square_root,
    store,
    sum_of_lanes,
    truncated,
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
def _sum_of_sixteen(values: Array) -> np.float32:
    together: np.float32 = sum_of_lanes(load(values, np.uint64(0), 16))
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


def test_lanes_are_added_up_in_the_stated_order() -> None:
    values = np.random.default_rng(1).normal(0, 10, 16).astype(np.float32)
    by_fours = values.reshape(4, 4)
    one, two, three, four = by_fours[0] + by_fours[1] + by_fours[2] + by_fours[3]
    assert _sum_of_sixteen(values) == (one + two) + (three + four)


@pytest.mark.parametrize("most", [1, 255])
def test_bytes_become_numbers_and_nothing_beside_is_written(most: int) -> None:
    values = np.random.default_rng(0).integers(0, most, 11, np.uint8, endpoint=True)
    result = np.zeros(12, np.float32)
    _of_eight_bytes(values, result)
    np.testing.assert_array_equal(result[2:10], values[3:].astype(np.float32) / np.float32(3))
    assert not result[[0, 1, 10, 11]].any()


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
