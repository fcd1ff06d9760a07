"""An object's frame in one go, against the same one function after another."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from layer_fakes import CAR, SHAPE, WHOLE, frame_of, grid, owned, picture, published, tracks

from mlbs_actors.appearance.cells import cells_won, in_cells, mean_of_cells
from mlbs_actors.appearance.colour_density import AppearanceParameters, confidence, warp_and_evaluate
from mlbs_actors.appearance.colour_model import update
from mlbs_actors.appearance.warp import warp_map
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import SolverError
from mlbs_actors.layer.layer import Layer
from mlbs_actors.layer.layer_state import LayerState
from mlbs_actors.layer.learning import near_trajectories, unexplained_cells
from mlbs_actors.layer.object_frame import ObjectView
from mlbs_actors.layer.object_regions import region_of_object, told_of
from mlbs_actors.layer.photometric import photometric_advantage
from mlbs_actors.layer.posterior_terms import finished_posterior, layer_cost, quantised_colours
from mlbs_actors.messages import (
    BACKGROUND,
    UNEXPLAINED_STEP,
    Array,
    FrameEvidence,
    LayerEvidence,
    Region,
    Segmentation,
    received,
)
from mlbs_actors.motion_field.field import MotionField, MotionParameters, motion_field

#: Two or three pixels of the small frames are a cell, and every term tells. Nodes are not where cells end.
WEIGHTS = {"motion": 1.0, "photometric": 1.0, "prior": 1.0, "distance": 2.0}
CONFIGS = {
    side: Config.model_validate({"appearance": {"cell_px": 4.0 * side}, "posterior": WEIGHTS})
    for side in (2, 3)
}
NOTHING = np.zeros((0, 2), np.float32)


def finished_in_steps(config: Config, state: LayerState, previous: Segmentation | None) -> Array:
    if previous is None or previous.frame_index != state.last_frame:
        return np.zeros((0, 0), np.float32)
    side = state.cell
    shares, learnt = cells_won(previous.labels, 1, state.region, side, state.trusted)
    update(state.model, state.image, learnt)
    cells = in_cells(state.region, side)
    return finished_posterior(config, state.cost, state.log_ratio, state.samples, previous, cells, shares)


def next_in_steps(
    side: int,
    state: LayerState,
    own: LayerEvidence,
    evidence: FrameEvidence,
    frame: Array,
    previous: Segmentation | None,
) -> tuple[LayerState, float, MotionField]:
    config = CONFIGS[side]
    weights, scale = config.posterior, length_scale(*SHAPE)
    posterior = finished_in_steps(config, state, previous)
    margins = (weights.region_margin_px, weights.covered_margin_px)
    told = told_of(1, previous)
    box = region_of_object(told, own.positions, own.motions, margins, scale, side, *SHAPE)
    region, velocity = Region(*box), state.velocity
    if len(own.motions):
        velocity = -np.median(own.motions, axis=0)
    parameters = MotionParameters.configured(config)
    shape, corner = (region.height, region.width), (region.x, region.y)
    field = motion_field(own.positions, own.motions, shape, -velocity, parameters, corner)

    cells, before = in_cells(region, side), in_cells(state.region, side)
    needed = np.ones((cells.height, cells.width), bool)
    motion = field.of_cells(side) * np.float32(1 / side)
    image = mean_of_cells(frame[region.slices], side)
    density = AppearanceParameters.configured(config, "object", side)
    model, log_density = warp_and_evaluate(state.model, cells, motion, image, density)
    log_ratio, samples = quantised_colours(log_density, model.count, needed, weights.appearance_cap)
    prior = warp_map(posterior, before, cells, motion, needed)
    trusted, away = np.empty(needed.shape, bool), np.empty(needed.shape, np.float32)
    near_trajectories(
        evidence.positions,
        *evidence.tracks_of(1)[3:],
        side,
        cells.x,
        cells.y,
        unexplained_cells(evidence, side),
        config.layers.unexplained_noise / UNEXPLAINED_STEP,
        np.float32(weights.close_px * scale),
        np.float32(weights.learn_px * scale),
        np.float32(weights.near_px * scale),
        np.float32(weights.fade_px * scale),
        trusted,
        away,
    )
    advantage = photometric_advantage(
        state.image,
        image,
        motion,
        evidence.camera,
        float(side),
        (cells.x, cells.y),
        (before.x, before.y),
        prior[0] >= 0.5,
        np.float32(weights.photometric_cap),
    )
    variance = np.ascontiguousarray(field.variance_of_cells(side))
    cost = layer_cost(
        config, "object", evidence, cells, side, needed, motion, variance, prior, away, advantage
    )
    trust = confidence(model.count, density).astype(np.float64).mean() if model.count.size else 0.0
    following = LayerState(
        evidence.frame_index, region, region, side, model, cost, log_ratio, samples, image,
        velocity.astype(np.float32), trusted,
    )  # fmt: skip
    return following, float(trust), field


def assert_same(found: LayerState, expected: LayerState) -> None:
    assert (found.last_frame, found.home, found.region) == (
        expected.last_frame,
        expected.home,
        expected.region,
    )
    assert (found.cell, found.model.region) == (expected.cell, expected.model.region)
    for one, other in zip(found.model.arrays, expected.model.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
    for name in ("image", "trusted", "cost", "log_ratio", "samples", "velocity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


def evidence_of(own: LayerEvidence, frame_index: int) -> FrameEvidence:
    far, rng = tracks(BACKGROUND, grid(WHOLE, 13), frame_index - 1), np.random.default_rng(4)
    flow = (6.0, -4.0)
    return received(
        replace(
            frame_of([far, own], frame_index, flow, reliable=True),
            camera=np.array([[1.02, 0.01, -2.0], [-0.02, 0.98, 1.5], [1e-5, -2e-5, 1.0]]),
            unexplained=rng.integers(0, 256, (SHAPE[0] // 2, SHAPE[1] // 2)).astype(np.uint8),
        )
    )


def shown(frame_index: int, region: Region, side: int) -> Segmentation:
    rng, cells = np.random.default_rng(6), (-(-SHAPE[0] // side), -(-SHAPE[1] // side))
    return received(
        replace(
            published(frame_index, owned(region), velocity=(1.0, 0.5)),
            normaliser=rng.integers(0, 256, cells).astype(np.uint8),
            fallback=rng.integers(-128, 128, cells).astype(np.int8),
        )
    )


@pytest.mark.parametrize("side", [2, 3])
@pytest.mark.parametrize(
    ("positions", "known", "empty"),
    [
        (grid(CAR), 0, False),
        (grid(Region(130, 95, 30, 25)), 0, False),  # at the border
        (NOTHING, 0, False),  # asleep, but its pixels are known
        (grid(CAR), None, False),
        (NOTHING, None, True),
    ],
)
def test_a_frame_is_seen_as_by_one_function_after_another(
    positions: Array, known: int | None, empty: bool, side: int
) -> None:
    rng = np.random.default_rng(3)
    first = tracks(1, grid(CAR))
    layer = Layer(CONFIGS[side], 1, "object")
    layer.step(evidence_of(first, 0), picture(0), None)
    state = layer.state
    for _ in range(3):  # so that there is something to move
        learnt = rng.random(state.trusted.shape) < 0.6
        update(state.model, rng.integers(0, 256, state.image.shape).astype(np.uint8), learnt)
    state.log_ratio[:] = rng.integers(-128, 128, state.log_ratio.shape)
    state.samples[:] = rng.integers(0, 17, state.samples.shape)
    motions = rng.normal(-1, 0.5, positions.shape).astype(np.float32)
    own = replace(first, last_frame=0, positions=positions, motions=motions)
    evidence, previous = evidence_of(own, 1), None
    if known is not None:
        previous = shown(known, Region(CAR.x + 5, CAR.y + 3, 31, 22), side)
    before, view = copy.deepcopy(state), ObjectView(CONFIGS[side], 1, SHAPE)
    found = view.next(state, evidence, picture(1), previous)
    expected, trust, field = next_in_steps(side, before, own, evidence, picture(1), previous)
    assert_same(found.state, expected)
    for one, other in zip(state.model.arrays, before.model.arrays, strict=True):
        np.testing.assert_array_equal(one, other, "learnt in place")
    assert found.confidence == pytest.approx(trust, abs=1e-9)
    layer.state = found.state
    told = layer.motion_field(own, evidence)  # to those who look on
    np.testing.assert_array_equal(told.mean, field.mean, strict=True)
    np.testing.assert_array_equal(told.variance, field.variance, strict=True)
    assert (found.state.cost.size == 0) == empty
    if known is not None and len(positions):  # where all terms have something to say
        assert found.state.trusted.any()
        assert len(np.unique(found.state.cost)) > 20


def test_a_newborn_sees_its_first_frame_as_by_one_function_after_another() -> None:
    own = tracks(1, grid(CAR), motion=(2.0, -1.0))
    evidence, state = evidence_of(own, 0), LayerState.beginning(16)
    found = ObjectView(CONFIGS[2], 1, SHAPE).next(state, evidence, picture(0), None)
    expected, trust, _ = next_in_steps(2, LayerState.beginning(16), own, evidence, picture(0), None)
    assert_same(found.state, expected)
    assert found.confidence == trust == 0


def test_evidence_that_is_not_finite_is_refused() -> None:
    own = tracks(1, grid(CAR), motion=(np.nan, 0.0))
    with pytest.raises(SolverError, match="finite"):
        ObjectView(CONFIGS[2], 1, SHAPE).next(LayerState.beginning(16), evidence_of(own, 0), picture(0), None)
