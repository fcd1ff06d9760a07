"""The coarser energy against the plain one, and how good a labelling from coarse to fine is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from energy_fakes import (
    MAX_COST,
    MOST_WHOLE,
    energy_of,
    in_quanta,
    laid_out,
    pairs,
    problem_of,
    random_problem,
    slow_energy,
    weights_of_image,
)

from mlbs_actors.graphcut.coarse_cut import MAX_BLOCK_COST, band_around_outlines, halved
from mlbs_actors.graphcut.energy import (
    NEIGHBOUR_OFFSETS,
    UNDECIDED,
    LabelCostEnergy,
    energy_of_pixels,
    undecided_energy_of,
)
from mlbs_actors.graphcut.graph_cut import minimise
from mlbs_actors.messages import Array


def unhalved(blocks: Array, shape: tuple[int, ...]) -> Array:
    """The labelling of pixels that the blocks' labels stand for."""
    return blocks.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]


def moving_scene(seed: int) -> LabelCostEnergy:
    """Three discs on 80×96 pixels; the evidence errs by whole patches, the image by pixels."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:80, :96]
    truth = np.zeros((80, 96), int)
    for label in range(1, 4):
        centre = rng.uniform([15, 15], [65, 80])
        truth[np.hypot(y - centre[0], x - centre[1]) < rng.uniform(9, 16)] = label
    doubt = np.stack([8.0 * cv2.GaussianBlur(rng.normal(0, 1, (80, 96)), (0, 0), 3.0) for _ in range(4)])
    unary = np.clip(1.0 * (np.arange(4)[:, None, None] != truth) + doubt, 0, None)
    image = np.clip(40 * truth[..., None] + rng.normal(80, 6, (80, 96, 3)), 0, 255).astype(np.uint8)
    return problem_of(unary, weights_of_image(image), np.array([0.0, 20.0, 20.0, 20.0]))


def slow_halved_weights(weights: Array) -> Array:
    """Sums over the pairs of two blocks, by what the cheapest outline nearby costs of one at their edge."""
    all_pairs, size = pairs(weights), weights.shape[:2]

    def outline(axis: int, place: int, block: int) -> int:
        """Between the lines ``place`` and ``place + 1`` of the image, along a block."""
        return sum(
            w
            for one, other, w in all_pairs
            if {one[axis], other[axis]} == {place, place + 1} and one[1 - axis] // 2 == block
        )

    def share(axis: int, edge: int, block: int) -> float:
        middle = 2 * edge + 1
        there = outline(axis, middle, block) if middle < size[axis] - 1 else 0
        near = [outline(axis, place, block) for place in range(middle - 1, min(middle + 2, size[axis] - 1))]
        return min(near) / there if there else 1.0

    joined: dict[tuple[int, int, int, int], int] = {}
    for one, other, w in all_pairs:
        blocks = sorted([(one[0] // 2, one[1] // 2), (other[0] // 2, other[1] // 2)])
        joined[(*blocks[0], *blocks[1])] = joined.get((*blocks[0], *blocks[1]), 0) + w
    found = np.zeros((-(-size[0] // 2), -(-size[1] // 2), 4), np.int32)
    for (v, u, below, beside), w in joined.items():
        shares = [share(1, min(u, beside), v)] if u != beside else []
        shares += [share(0, v, u)] if v != below else []
        for k in range(4):
            if shares and tuple(NEIGHBOUR_OFFSETS[k]) == (below - v, beside - u):
                found[v, u, k] = int(w * min(shares))
    return found


#: Most pixels cut without a coarser level: more than any image here has.
WHOLE = (10**6,)
SHAPES = [(3, 6, 8), (2, 5, 7), (3, 1, 6), (2, 7, 1), (2, 1, 1)]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_labelling_of_blocks_has_the_same_energy_on_both_scales_where_all_places_are_alike(
    shape: tuple[int, int, int],
) -> None:
    for seed in range(3):
        _, height, width = shape
        sizes = ((height, width - 1), (height - 1, width), (height - 1, width - 1), (height - 1, width - 1))
        alike = laid_out(*(np.full(one, 100 + 10 * seed + kind) for kind, one in enumerate(sizes)))
        problem = random_problem(seed, shape, 5.0)._replace(weights=alike)
        coarse = halved(problem)
        rng = np.random.default_rng(seed)
        blocks = rng.integers(0, shape[0], coarse.unary.shape[1:])
        assert slow_energy(blocks, coarse) == slow_energy(unhalved(blocks, shape[1:]), problem)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_outline_of_blocks_costs_what_the_cheapest_one_near_it_does(shape: tuple[int, int, int]) -> None:
    for seed in range(3):
        problem = random_problem(seed, shape, 5.0)
        np.testing.assert_array_equal(halved(problem).weights, slow_halved_weights(problem.weights))


def test_an_edge_of_the_image_between_the_pixels_of_a_block_is_not_lost() -> None:
    costly = np.full((8, 8, 4), 50, np.int32)
    costly[:, 2, [0, 2]] = costly[:, 3, 3] = 1
    costly[:, -1, 0] = costly[-1, :, 1:] = costly[:, -1, 2] = costly[:, 0, 3] = 0
    coarse = halved(energy_of(np.zeros((2, 8, 8), np.int32), costly, np.zeros(2, np.int64)))
    # Columns 2 and 3 are a block: its outlines to either side cost what the edge within it does.
    assert coarse.weights[:, [0, 1], 0].max() <= 4 < coarse.weights[:, 2, 0].min()


@pytest.mark.parametrize("side", [1, 2, 3, 4])
@pytest.mark.parametrize("shape", [(3, 7, 9), (2, 6, 8), (2, 1, 5)])
def test_costs_of_cells_and_of_single_pixels_are_those_of_all_pixels(
    side: int, shape: tuple[int, int, int]
) -> None:
    rng = np.random.default_rng(side)
    count, height, width = shape
    problem = random_problem(side, shape, 5.0)
    cells = rng.integers(0, 900, (count, -(-height // side), -(-width // side))).astype(np.int32)
    extras = np.array([rng.integers(0, (*shape, 500)) for _ in range(6)], np.int64)
    given = energy_of(cells, problem.weights, problem.label_costs, side, extras)
    unary = np.array(
        [
            [[cells[k, y // side, x // side] for x in range(width)] for y in range(height)]
            for k in range(count)
        ],
        np.int32,
    )
    for k, y, x, cost in extras:
        unary[k, y, x] += cost
    plain = energy_of(unary, problem.weights, problem.label_costs)
    np.testing.assert_array_equal(energy_of_pixels(given).unary, unary)
    coarse, of_blocks = halved(given), halved(plain)
    np.testing.assert_array_equal(energy_of_pixels(coarse).unary, of_blocks.unary)
    np.testing.assert_array_equal(coarse.weights, of_blocks.weights)
    np.testing.assert_array_equal(
        energy_of_pixels(halved(coarse)).unary, energy_of_pixels(halved(of_blocks)).unary
    )
    labels = rng.integers(0, count, (height, width))
    blocks = labels[::2, ::2].astype(np.int16)
    bands = [band_around_outlines(one, blocks)[1].unaries for one in (given, plain)]
    np.testing.assert_array_equal(bands[0].pixel, bands[1].pixel)
    np.testing.assert_array_equal(bands[0].cost, bands[1].cost)
    np.testing.assert_array_equal(minimise(given, MOST_WHOLE), minimise(plain, MOST_WHOLE))


def test_what_no_pixel_may_have_no_block_may_have() -> None:
    unary = np.full((2, 4, 4), MAX_BLOCK_COST, np.int32)
    unary[0] = 0
    coarse = halved(energy_of(unary, np.zeros((4, 4, 4), np.int32), np.zeros(2, np.int64)))
    assert (coarse.unary[1] == MAX_BLOCK_COST).all()


def test_only_pixels_near_an_outline_are_open_and_the_rest_is_folded_into_their_costs() -> None:
    problem = moving_scene(0)
    blocks = np.zeros((40, 48), np.int16)
    blocks[10:25, 15:35] = 2
    labels: Array = unhalved(blocks, (80, 96)).astype(np.intp)
    opened, rest, start = band_around_outlines(problem, blocks)
    assert rest.elsewhere.tolist() == [True, False, True, False]
    open_pixels: Array = np.isin(np.arange(labels.size).reshape(labels.shape), rest.pixels)
    np.testing.assert_array_equal(np.where(open_pixels, UNDECIDED, labels), opened)
    # A pixel to either side, also around the corners.
    near = np.zeros(labels.shape, bool)
    for y, x in np.argwhere(labels[:-1, :] != labels[1:, :]):
        near[y : y + 2, x - 1 : x + 2] = True
    for y, x in np.argwhere(labels[:, :-1] != labels[:, 1:]):
        near[y - 1 : y + 2, x : x + 2] = True
    np.testing.assert_array_equal(open_pixels, near)
    before: Array = labels.reshape(-1)[rest.pixels]
    other = labels.copy()
    np.testing.assert_array_equal(start, before)
    other[20, 40], other[19, 35] = 0, 2
    after = other.reshape(-1)[rest.pixels]
    assert undecided_energy_of(rest, after) - undecided_energy_of(rest, before) == slow_energy(
        other, problem
    ) - slow_energy(labels, problem)


@pytest.mark.parametrize("shape", [(11, 14), (8, 8), (1, 7), (6, 1)])
@pytest.mark.parametrize("side", [1, 2, 3, 4])
def test_a_label_that_can_only_be_in_its_place_costs_too_much_elsewhere(
    side: int, shape: tuple[int, int]
) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        problem = random_problem(seed, (4, *shape), 3.0)
        rows, columns = -(-shape[0] // side), -(-shape[1] // side)
        unary = rng.integers(0, 3000, (4, rows, columns)).astype(np.int32)
        places, extras = np.array([[0, rows, 0, columns]] * 4), []
        dear = unary.copy()
        for label in range(1, 4):
            top, left = int(rng.integers(0, rows)), int(rng.integers(0, columns))
            bottom, right = int(rng.integers(top, rows)) + 1, int(rng.integers(left, columns)) + 1
            places[label] = top, bottom, left, right
            outside = np.ones((rows, columns), bool)
            outside[top:bottom, left:right] = False
            dear[label][outside] = MAX_COST
            unary[label][outside] = -(2**20)  # is not looked at
            extras.append((label, min(bottom * side, shape[0]) - 1, left * side, -2000))
        pulls = np.array(extras, np.int64)
        plain = energy_of(dear, problem.weights, problem.label_costs, side, pulls)
        placed = energy_of(unary, problem.weights, problem.label_costs, side, pulls, places)
        for large in (WHOLE, (20,)):
            np.testing.assert_array_equal(minimise(placed, large), minimise(plain, large))


@pytest.mark.parametrize("seed", range(4))
def test_coarse_to_fine_finds_nearly_the_labels_of_the_whole_cut(seed: int) -> None:
    problem = moving_scene(seed)
    exact, found = minimise(problem, WHOLE), minimise(problem, (2000,))
    blank = slow_energy(np.zeros((80, 96), np.intp), problem)
    # Of what the whole cut gains over no object at all, nearly everything.
    gain = blank - slow_energy(exact, problem)
    assert blank - slow_energy(found, problem) >= 0.97 * gain
    # 11.5 % in the worst of these noisy scenes.
    assert (found != exact).sum() <= 0.12 * (exact > 0).sum()


def test_smooth_costs_give_the_very_same_labels() -> None:
    y, x = np.mgrid[:64, :64]
    inside: Array = 2.0 * np.tanh((20 - np.hypot(y - 30, x - 33)) / 3)
    unary = np.stack([np.maximum(inside, 0), np.maximum(-inside, 0)])
    image = np.full((64, 64, 3), 90, np.uint8)
    problem = energy_of(in_quanta(unary), weights_of_image(image), np.zeros(2, np.int64))
    np.testing.assert_array_equal(minimise(problem, (2000,)), minimise(problem, WHOLE))


def test_every_coarser_level_has_its_own_bound() -> None:
    problem = moving_scene(1)  # 7680 px: 1920 blocks, or 480 blocks of blocks, or 120 of those
    none = 0
    levels = [WHOLE, (none, *WHOLE), (none, none, *WHOLE), (none, none, none, *WHOLE)]
    bounds = [(7680, none), (7679, 1920, none), (7679, 1919, 480, none), (400,)]
    found = [minimise(problem, most) for most in bounds]
    for labels, most in zip(found, levels, strict=True):
        np.testing.assert_array_equal(labels, minimise(problem, most))
    assert len({labels.tobytes() for labels in found}) == len(bounds)
