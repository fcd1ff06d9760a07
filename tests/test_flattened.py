"""Flat arrays in kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

from mlbs_actors.compilation import compiled
from mlbs_actors.flattened import flattened
from mlbs_actors.messages import Array


@compiled()
def _flat(array: Array) -> Any:
    return flattened(array)


@compiled()
def _doubled(array: Array) -> Any:
    """The array itself is gone when the flat one is read."""
    made = array * 2
    flat = flattened(made)
    made = np.zeros((1,) * 3)
    return flat, made, np.full(array.shape, -1.0)


@compiled(in_place=True)
def _fill(array: Array, value: float) -> None:
    flat = flattened(array)
    for at in range(flat.size):
        flat[at] = value + at


@pytest.mark.parametrize("shape", [(7,), (3, 4), (2, 3, 5), (0, 4), (1, 1, 1)])
@pytest.mark.parametrize("kind", [np.uint8, np.float32, np.int64])
def test_a_flat_array_has_the_numbers_in_order(shape: tuple[int, ...], kind: type) -> None:
    array: Array = np.random.default_rng(2).integers(0, 200, shape).astype(kind)
    np.testing.assert_array_equal(_flat(array), array.reshape(-1))


def test_its_memory_is_that_of_the_array() -> None:
    array = np.zeros((3, 4, 2))
    assert np.shares_memory(_flat(array), array)
    _fill(array[1:], 5.0)
    np.testing.assert_array_equal(array.reshape(-1), [0.0] * 8 + [5.0 + at for at in range(16)])


def test_it_keeps_the_memory_that_it_lies_in() -> None:
    array = np.random.default_rng(3).random((4, 5, 6))
    flat, *_ = _doubled(array)
    np.testing.assert_array_equal(flat, 2 * array.reshape(-1))


def test_an_array_with_gaps_is_not_taken() -> None:
    with pytest.raises(TypingError):
        _flat(np.zeros((4, 6))[:, ::2])
