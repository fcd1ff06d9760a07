"""Points are found in a box as by a look at each of them."""

from __future__ import annotations

import numpy as np
import pytest
from read_only import read_only

from mlbs_actors.geometry.points_in_box import points_in_box
from mlbs_actors.messages import Array


def looked_at(positions: Array, left: float, top: float, right: float, bottom: float) -> list[int]:
    return [
        point
        for point, (x, y) in enumerate(positions.tolist())
        if left <= round(x) < right and top <= round(y) < bottom
    ]


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 500])
@pytest.mark.parametrize(
    "box", [(10, 5, 30, 40), (0, 0, 64, 48), (20, 20, 20, 30), (-np.inf, 5, 12, np.inf)], ids=str
)
def test_points_are_found_as_by_a_look_at_each(count: int, box: tuple[float, float, float, float]) -> None:
    rng = np.random.default_rng(count)
    positions = (rng.random((count, 2)) * (70, 54) - 3).astype(np.float32)
    positions[::3] = np.floor(positions[::3]) + np.float32(0.5)  # halves go to the even one
    assert points_in_box(read_only(positions), *box).tolist() == looked_at(positions, *box)
