"""The discount for cast shadows, against loops."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import Array
from mlbs_actors.segmentation.unaries import discount_shadows

STRENGTH = np.float32(3.0)


def discounted(costs: Array, shadow: Array, caster: float) -> Array:
    slow = costs.copy()
    for label in range(1, len(costs)):
        for y, x in np.ndindex(*shadow.shape):
            lead = max(costs[0, y, x] - costs[label, y, x], 0)
            slow[label, y, x] += round(caster * float(shadow[y, x]) * (lead + float(STRENGTH)))
    return slow


@pytest.mark.parametrize(("body", "caster"), [(0, 0.0), (2, 0.0), (3, 0.5), (4, 1.0), (20, 1.0)], ids=str)
def test_what_is_claimed_but_shadow_and_ground_casts_none(body: int, caster: float) -> None:
    """Of 40 claimed cells, half are lit ground and some something else; it takes a tenth to cast the rest."""
    costs = np.full((2, 8, 10), 50, np.int32)
    costs[1, :4] = 20
    costs[1, 4:] = 60
    shadow, lit = np.zeros((8, 10), np.float32), np.zeros((8, 10), np.float32)
    lit[:2] = 1
    shadow[2:] = 1
    shadow[2:4].reshape(-1)[:body] = 0
    places = np.array([[0, 8, 0, 10], [0, 8, 0, 10]])
    given = costs.copy()
    discount_shadows(costs, places, shadow, lit, STRENGTH, 0.1)
    np.testing.assert_allclose(costs, discounted(given, shadow, caster), atol=1)
    assert (costs[0] == given[0]).all()


def test_one_of_several_claims_is_enough_to_cast_the_shadows_of_all() -> None:
    costs = np.full((3, 4, 8), 50, np.int32)
    costs[1, :, :4] = costs[2, :, 4:] = 20
    shadow, lit = np.zeros((4, 8), np.float32), np.zeros((4, 8), np.float32)
    shadow[:, :4] = 1
    places = np.array([[0, 4, 0, 8], [0, 4, 0, 4], [0, 4, 4, 8]])
    discount_shadows(costs, places, shadow, lit, STRENGTH, 0.1)
    assert (costs[1, :, :4] == 20 + 33).all()
    assert (costs[2, :, 4:] == 20).all()


def test_where_nothing_is_claimed_a_shadow_costs_as_ever() -> None:
    costs = np.full((2, 2, 2), 50, np.int32)
    ones = np.ones((2, 2), np.float32)
    discount_shadows(costs, np.array([[0, 2, 0, 2]] * 2), ones, 0 * ones, STRENGTH, 0.1)
    assert (costs[1] == 53).all()
