"""Half precision made single against NumPy's conversion."""

import numpy as np

from mlbs_actors.half_precision import single_precision


def test_every_finite_number_is_the_same() -> None:
    every = np.arange(2**16, dtype=np.uint16).view(np.float16)
    finite = every[np.isfinite(every)].reshape(-1, 2, 1)
    single = single_precision(finite.view(np.uint16), 0, len(finite), 0, 2)
    assert single.dtype == np.float32
    np.testing.assert_array_equal(single, finite.astype(np.float32))
    np.testing.assert_array_equal(np.signbit(single), np.signbit(finite))


def test_a_part_of_an_array_may_be_given() -> None:
    halves = np.random.default_rng(0).normal(0, 5, (9, 7, 2)).astype(np.float16)
    single = single_precision(halves.view(np.uint16), 2, 5, 3, 7)
    np.testing.assert_array_equal(single, halves[2:5, 3:].astype(np.float32))
