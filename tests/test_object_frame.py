"""An object's frame in one go, against the same one function after another."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from layer_fakes import CAR, SHAPE, WHOLE, frame_of, grid, owned, picture, published, tracks

from mlbs_actors.appearance import update
from mlbs_actors.cells import cells_won, in_cells, mean_of_cells
from mlbs_actors.config import Config, length_scale
from mlbs_actors.gabp import MotionField, MotionParameters, motion_field
from mlbs_actors.kde import AppearanceParameters, confidence, warp_and_evaluate
from mlbs_actors.layer import Layer
from mlbs_actors.layer_cost import finished_posterior, layer_cost, quantised_colours
from mlbs_actors.layer_view import LastFrame, LayerView, SeenFrame
from mlbs_actors.learning import near_trajectories, unexplained_cells
from mlbs_actors.messages import BACKGROUND, UNEXPLAINED_STEP, FrameEvidence, LayerEvidence, Region
from mlbs_actors.photometric import photometric_advantage
from mlbs_actors.warp import warp_map

#: Two pixels of the small frames are a cell, and every term tells.
WEIGHTS = {"motion": 1.0, "photometric": 1.0, "prior": 1.0, "distance": 2.0}
CONFIGS = {
    side: Config.model_validate({"appearance": {"cell_px": 4.0 * side}, "posterior": WEIGHTS})
    for side in (2, 3)
}
SIDE = 2
CONFIG = CONFIGS[SIDE]
AROUND = Region(52, 32, 60, 44)


def seen_in_steps(
    side: int,
    frame_evidence: FrameEvidence,
    own: LayerEvidence,
    last: LastFrame,
    region: Region,
    field: MotionField,
) -> SeenFrame:
    config = CONFIGS[side]
    weights, colours, scale = config.posterior, config.appearance, length_scale(*SHAPE)
    cells, before = in_cells(region, side), in_cells(last.region, side)
    needed = np.ones((cells.height, cells.width), bool)
    motion = field.of_cells(side) * np.float32(1 / side)
    image = mean_of_cells(picture(1)[region.slices], side)
    density = AppearanceParameters(
        colours.bandwidth_floor, colours.registration_px / side, colours.half_confidence_samples
    )
    model, log_density = warp_and_evaluate(last.model, cells, motion, image, density)
    log_ratio, samples = quantised_colours(log_density, model.count, needed, weights.appearance_cap)
    prior = warp_map(last.posterior, before, cells, motion, needed)
    trusted, away = np.empty(needed.shape, bool), np.empty(needed.shape, np.float32)
    near_trajectories(
        frame_evidence.positions,
        *frame_evidence.part(own.layer),
        side,
        cells.x,
        cells.y,
        unexplained_cells(frame_evidence, side),
        config.layers.unexplained_noise / UNEXPLAINED_STEP,
        np.float32(weights.close_px * scale),
        np.float32(weights.learn_px * scale),
        np.float32(weights.near_px * scale),
        np.float32(weights.fade_px * scale),
        trusted,
        away,
    )
    advantage = photometric_advantage(
        last.image,
        image,
        motion,
        frame_evidence.camera,
        float(side),
        (cells.x, cells.y),
        (before.x, before.y),
        prior[0] >= 0.5,
        np.float32(weights.photometric_cap),
    )
    variance = np.ascontiguousarray(field.variance_of_cells(side))
    cost = layer_cost(
        config, "object", frame_evidence, cells, side, needed, motion, variance, prior, away, advantage
    )
    trust = confidence(model.count, density).astype(np.float64).mean() if model.count.size else 0.0
    return SeenFrame(model, image, trusted, cost, log_ratio, samples, float(trust))


@pytest.mark.parametrize("region", [AROUND, Region(120, 90, 40, 30), Region(0, 0, 0, 0)])
@pytest.mark.parametrize("born", [True, False])
@pytest.mark.parametrize("side", [2, 3])
def test_a_frame_is_seen_as_by_one_function_after_another(region: Region, born: bool, side: int) -> None:
    layer, rng = Layer(CONFIGS[side], 1, "object"), np.random.default_rng(3)
    first = tracks(1, grid(CAR))
    if not born:
        layer.step(first, frame_of([first]), picture(0), None)
        state = layer.state
        for _ in range(3):
            learnt = rng.random(state.trusted.shape) < 0.6
            update(state.model, rng.integers(0, 256, state.image.shape).astype(np.uint8), learnt)
    state = layer.state
    posterior = rng.random(state.cost.shape).astype(np.float32)
    last = LastFrame(state.region, state.model, state.image, posterior)
    own = replace(first, last_frame=0, motions=rng.normal(-1, 0.5, first.motions.shape).astype(np.float32))
    far = tracks(BACKGROUND, grid(WHOLE, 13), 0)
    evidence = replace(
        frame_of([far, own], 1, (6.0, -4.0), reliable=True),
        camera=np.array([[1.02, 0.01, -2.0], [-0.02, 0.98, 1.5], [1e-5, -2e-5, 1.0]]),
        unexplained=rng.integers(0, 256, (SHAPE[0] // 2, SHAPE[1] // 2)).astype(np.uint8),
    )
    shape, corner = (region.height, region.width), (region.x, region.y)
    field = motion_field(own.positions, own.motions, shape, np.ones(2), MotionParameters(), corner)
    view = LayerView(CONFIGS[side], "object", SHAPE)
    found = view.of_object(picture(1), own, evidence, last, region, field)
    expected = seen_in_steps(side, evidence, own, last, region, field)
    assert found.model.region == expected.model.region
    for one, other in zip(found.model.arrays, expected.model.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
    for name in ("image", "trusted", "cost", "log_ratio", "samples"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
    assert found.confidence == pytest.approx(expected.confidence, abs=1e-9)
    if region == AROUND and not born:  # where all terms have something to say
        assert found.trusted.any()
        assert found.samples.any()
        assert len(np.unique(found.cost)) > 20


def test_a_frame_is_finished_as_by_one_function_after_another() -> None:
    layer, own, rng = Layer(CONFIG, 1, "object"), tracks(1, grid(CAR)), np.random.default_rng(5)
    layer.step(own, frame_of([own]), picture(0), None)
    layer.state.samples[:] = rng.integers(0, 17, layer.state.samples.shape)
    layer.state.log_ratio[:] = rng.integers(-128, 128, layer.state.log_ratio.shape)
    state, grid_of_cells = copy.deepcopy(layer.state), (SHAPE[0] // SIDE, SHAPE[1] // SIDE)
    previous = replace(
        published(0, owned(Region(CAR.x + 5, CAR.y + 3, 31, 22))),
        normaliser=rng.integers(0, 256, grid_of_cells).astype(np.uint8),
        fallback=rng.integers(-128, 128, grid_of_cells).astype(np.int8),
    )
    shares, learnt = cells_won(previous.labels, 1, state.region, SIDE, state.trusted)
    update(state.model, state.image, learnt)
    expected = finished_posterior(
        CONFIG, state.cost, state.log_ratio, state.samples, previous, in_cells(state.region, SIDE), shares
    )
    found = layer._finish(previous)
    assert found.tobytes() == expected.tobytes()
    assert len(np.unique(found)) > 50
    assert state.model.count.any()
    for one, other in zip(layer.state.model.arrays, state.model.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
