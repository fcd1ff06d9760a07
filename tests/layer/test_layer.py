"""One layer: what it refuses, where it works, and each of its terms on its own."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from layer_fakes import CAR, SHAPE, WHOLE, frame_of, grid, owned, picture, published, tracks

from mlbs_actors.appearance.fusion import with_appearance
from mlbs_actors.config import Config
from mlbs_actors.errors import LayerError
from mlbs_actors.geometry.boxes import slices_in
from mlbs_actors.geometry.distance import trajectory_distance
from mlbs_actors.layer.layer import Layer
from mlbs_actors.messages import (
    BACKGROUND,
    COST_STEP,
    UNEXPLAINED_STEP,
    Array,
    LayerEvidence,
    LayerPosterior,
    Region,
    Segmentation,
    readonly,
)

#: Every term is off; each test switches on what it is about.
SILENT = {"appearance": 0.0, "motion": 0.0, "photometric": 0.0, "prior": 0.0, "distance": 0.0, "offset": 4.0}
#: Lengths are stated for 640×480.
SCALE = 0.25
HALF = Config().appearance.half_confidence_samples


def configured(**posterior: float) -> Config:
    return Config.model_validate({"posterior": {**SILENT, **posterior}})


def step(
    layer: Layer,
    frame_index: int,
    image: Array,
    positions: Array,
    previous: Segmentation | None = None,
    motion: tuple[float, float] = (0.0, 0.0),
    rival: Array | None = None,
) -> LayerPosterior:
    """One step with the evidence that is due; ``rival`` are an object's trajectories for the background."""
    own = tracks(layer.layer, positions, layer.state.last_frame, motion)
    if layer.layer == BACKGROUND:
        everyone = [own] if rival is None else [own, tracks(1, rival, frame_index - 1)]
        return layer.step(frame_of(everyone, frame_index, image=image), previous)
    far = grid(Region(0, 0, 160, 20))
    everyone = [tracks(BACKGROUND, far, frame_index - 1), own]
    return layer.step(frame_of(everyone, frame_index, image=image), previous)


def nats(one: LayerPosterior, appearance: float = 0.0) -> Array:
    """The cost, with the colours judged by the layer alone."""
    alone = np.zeros(one.cost.shape, np.int8)
    cost = with_appearance(one.cost, one.log_ratio, one.samples, alone, appearance, HALF)
    return np.asarray(cost * COST_STEP, np.float64)


# What is refused


def test_evidence_of_another_layer_is_refused() -> None:
    evidence = tracks(2, grid(CAR))
    with pytest.raises(LayerError, match=r"Frame 0 has no evidence of layer 1; restart .*\."):
        Layer(configured(), 1, "object").step(frame_of([evidence]), None)


@pytest.mark.parametrize("last_frame", [-1, 0, 2])
def test_evidence_that_is_not_the_next_is_refused_and_changes_nothing(last_frame: int) -> None:
    config = configured(appearance=1.0, prior=1.0)
    layer, undisturbed = Layer(config, 1, "object"), Layer(config, 1, "object")
    results = []
    for one in (layer, undisturbed):
        for t in range(2):
            previous = published(t - 1, owned(CAR)) if t else None
            step(one, t, picture(t), grid(CAR), previous)
    evidence = tracks(1, grid(CAR), last_frame)
    with pytest.raises(LayerError, match=f"stands at frame 1 .* from frame {last_frame}; restart the stream"):
        layer.step(frame_of([evidence], 2, image=picture(2)), published(1, owned(CAR)))
    for one in (layer, undisturbed):
        results.append(step(one, 2, picture(2), grid(CAR), published(1, owned(CAR))))
    assert results[0].cost.tobytes() == results[1].cost.tobytes()


# Where it works


def test_the_background_lives_on_the_frame_and_is_evaluated_around_the_objects() -> None:
    for positions in (grid(WHOLE, 10), np.zeros((0, 2), np.float32)):
        layer, rival = Layer(configured(), 0, "background"), Layer(configured(), 1, "object")
        region = step(layer, 0, picture(), positions, rival=grid(CAR)).region
        own = step(rival, 0, picture(), grid(CAR)).region
        assert region == Region(own.x - 1, own.y - 1, own.width + 2, own.height + 2)
        assert layer.state.home == WHOLE
    alone = Layer(configured(), 0, "background")
    assert step(alone, 0, picture(), grid(WHOLE, 10)).region.area == 0
    assert alone.state.home == WHOLE


def test_an_objects_region_is_the_box_of_its_trajectories_with_a_margin() -> None:
    config = configured(region_margin_px=20.0)
    region = step(
        Layer(config, 1, "object"), 0, picture(), np.array([[60, 50], [90, 75.5]], np.float32)
    ).region
    assert region == Region(55, 45, 41, 37)  # the margin is 5 px at this size


def test_a_region_ends_at_the_frame() -> None:
    config = configured(region_margin_px=40.0)
    corner = np.array([[1, 2], [158, 20]], np.float32)
    assert step(Layer(config, 1, "object"), 0, picture(), corner).region == Region(0, 0, 160, 31)


def test_a_region_holds_the_moved_pixels_of_the_frame_before_too() -> None:
    layer = Layer(configured(region_margin_px=0.0), 1, "object")
    step(layer, 0, picture(), grid(CAR), motion=(-5.0, 0.0))
    some = grid(CAR)[:3] + np.array([5.0, 0.0], np.float32)
    region = step(layer, 1, picture(1), some, published(0, owned(CAR)), motion=(-5.0, 0.0)).region
    pixels = Region(CAR.x + 2, CAR.y + 2, 37, 25)  # those inside the layer's region at frame 0
    assert region.x <= pixels.x + 5
    assert region.x + region.width >= pixels.x + pixels.width + 5
    assert region.y <= pixels.y
    assert region.y + region.height >= pixels.y + pixels.height


@pytest.mark.parametrize("side", [1, 3, 5])
def test_a_layer_without_trajectories_and_pixels_has_an_empty_region(side: int) -> None:
    weights = {**SILENT, "appearance": 1.0, "motion": 1.0, "prior": 1.0, "distance": 1.0}
    config = Config.model_validate({"posterior": weights, "grid": {"cell_px": side / SCALE}})
    layer = Layer(config, 1, "object")
    nothing = np.zeros((0, 2), np.float32)
    for t in range(3):
        result = step(layer, t, picture(t), nothing, published(t - 1, owned(WHOLE, 0)) if t else None)
        assert result.region.area == 0
        assert result.cost.size == 0
        assert result.confidence == 0.0


def test_an_object_can_leave_the_frame() -> None:
    config = configured(appearance=1.0, motion=1.0, prior=1.0, distance=1.0, region_margin_px=0.0)
    layer = Layer(config, 1, "object")
    right = Region(130, 40, 30, 30)
    step(layer, 0, picture(), grid(right), motion=(-60.0, 0.0))
    gone = step(
        layer, 1, picture(1), np.zeros((0, 2), np.float32), published(0, owned(right), velocity=(60.0, 0.0))
    )
    assert gone.region.area == 0
    later = step(layer, 2, picture(2), np.zeros((0, 2), np.float32), published(1, owned(WHOLE, 0)))
    assert later.region.area == 0


def test_the_background_is_evaluated_where_an_object_can_be_and_learns_everywhere() -> None:
    config = configured(appearance=1.0, motion=1.0, prior=1.0, region_margin_px=40.0)
    contested = np.zeros(SHAPE, bool)
    contested[32:77, 52:109] = True  # the trajectories, and 10 px around
    layer = Layer(config, 0, "background")
    for t in range(3):
        previous = published(t - 1, owned(WHOLE, 0), normaliser=0) if t else None
        result = step(layer, t, picture(t), grid(WHOLE), previous, rival=grid(CAR))
    assert result.region == Region(51, 31, 59, 47)
    inside = contested[result.region.slices]
    assert inside.sum() == contested.sum()
    assert (nats(result)[~inside] == 4.0).all()
    assert not result.samples[~inside].any()
    assert not result.log_ratio[~inside].any()
    assert (nats(result)[inside] != 4.0).all()
    assert result.samples[inside].any()
    assert result.log_ratio[inside].any()
    assert (layer.state.model.count[~contested] == 2).all()


def test_outside_its_region_a_layer_is_as_dear_as_can_be() -> None:
    result = step(Layer(configured(), 1, "object"), 0, picture(), grid(CAR))
    assert result.cost.shape == (result.region.height, result.region.width)
    assert result.cost.dtype == np.uint8
    assert result.outside_cost == 255


# Each term


def test_with_every_term_off_only_the_offset_is_left() -> None:
    result = step(Layer(configured(), 1, "object"), 0, picture(), grid(CAR))
    np.testing.assert_array_equal(nats(result), 4.0)


def test_a_new_born_layer_does_not_judge_colours() -> None:
    result = step(Layer(configured(appearance=1.0), 1, "object"), 0, picture(), grid(CAR))
    np.testing.assert_array_equal(nats(result, 1.0), 4.0)
    assert result.confidence == 0.0


def test_what_looks_as_before_is_cheap_and_what_looks_otherwise_is_dear() -> None:
    exact = {"background_registration_px": 0.0}  # noise is steep everywhere
    config = Config.model_validate({"posterior": {**SILENT, "appearance": 1.0}, "appearance": exact})
    layer = Layer(config, 0, "background")
    image = picture()
    for t in range(6):
        step(layer, t, image, grid(WHOLE), published(t - 1, owned(WHOLE, 0)) if t else None)
    changed = image.copy()
    changed[CAR.slices] = 255 - image[CAR.slices]
    ends = np.array([[0, 0], [159, 119]], np.float32)  # an object can be anywhere
    result = step(layer, 6, changed, grid(WHOLE), published(5, owned(WHOLE, 0)), rival=ends)
    strange = np.abs(changed.astype(int) - image).max(axis=2) > 60
    assert nats(result, 1.0)[strange].min() > 4.5
    same = np.ones(SHAPE, bool)
    same[CAR.slices] = False
    assert nats(result, 1.0)[same].max() < 4.0 - 1.0
    assert 0.5 < result.confidence <= 1.0


def test_a_layer_learns_only_the_pixels_that_it_won() -> None:
    config = configured(appearance=1.0, learn_px=1000.0)
    layer = Layer(config, 1, "object")
    won = Region(70, 45, 12, 14)
    step(layer, 0, picture(), grid(CAR))
    step(layer, 1, picture(), grid(CAR), published(0, owned(won)))
    counts = np.zeros(SHAPE, int)
    counts[layer.state.region.slices] = layer.state.model.count
    assert (counts[won.slices] == 1).all()
    assert counts.sum() == won.area


@pytest.mark.parametrize("frame_index", [0, 1])
def test_the_background_learns_away_from_objects_beside_its_own_trajectories_and_where_nothing_moves(
    frame_index: int,
) -> None:
    rng = np.random.default_rng(0)
    own, objects = (rng.uniform(0, 1, (count, 2)) * [159, 119] for count in (30, 4))
    objects = objects * 0.3 + [60, 40]
    config = configured(keep_off_px=80.0, learn_px=20.0)
    evidence = frame_of([tracks(0, own.astype(np.float32)), tracks(1, objects.astype(np.float32))])
    unexplained = np.where(rng.random(SHAPE) < 0.5, 0, 255).astype(np.uint8)
    evidence = readonly(replace(evidence, unexplained=unexplained, frame_index=frame_index))
    layer = Layer(config, 0, "background")
    layer.step(evidence, None)
    # Distances are told for four cells at once: what hangs on less than that may go either way.
    near_own, near_object = (trajectory_distance(one.positions, WHOLE, 1) for one in evidence.layers)
    shown = unexplained * UNEXPLAINED_STEP < 0.5 * config.layers.unexplained_noise
    surely, perhaps = (
        (near_object > 80.0 * SCALE + slack)
        | (near_own + 2.0 * SCALE + slack < near_object)
        | ((near_object > 20.0 * SCALE + slack) & shown & (frame_index > 0))
        for slack in (4.0, -4.0)
    )
    trusted = layer.state.trusted
    assert trusted[surely].all()
    assert not trusted[~perhaps].any()
    assert 0.01 < (~perhaps).mean() < surely.mean()


def test_a_layer_does_not_learn_from_a_map_of_another_frame() -> None:
    layer = Layer(configured(appearance=1.0, learn_px=1000.0), 1, "object")
    step(layer, 0, picture(), grid(CAR))
    step(layer, 1, picture(), grid(CAR), None)
    step(layer, 2, picture(), grid(CAR), published(0, owned(CAR)))
    assert not layer.state.model.count.any()


def motion_cost(
    flow: tuple[float, float], reliable: bool = True, explained: bool = False, weight: float = 1.0
) -> Array:
    """Cost, less the offset, of a car that moves by (4, 0) where the dense flow says ``flow``."""
    config = configured(motion=weight, object_motion_floor=0.05)
    own = tracks(1, grid(CAR), motion=(-4.0, 0.0))
    evidence = frame_of([tracks(BACKGROUND, grid(Region(0, 0, 160, 20))), own], 0, flow, reliable)
    if explained:
        evidence = readonly(replace(evidence, unexplained=np.zeros_like(evidence.unexplained)))
    result = Layer(config, 1, "object").step(evidence, None)
    inner = Region(CAR.x + 6, CAR.y + 6, CAR.width - 12, CAR.height - 12)
    whole = np.full(SHAPE, np.nan)
    whole[result.region.slices] = nats(result) - 4.0
    return np.asarray(whole[inner.slices])


def test_a_flow_that_agrees_costs_nothing_and_one_that_contradicts_costs_the_floor() -> None:
    assert np.abs(motion_cost((-4.0, 0.0))).max() < 0.1
    np.testing.assert_allclose(motion_cost((30.0, 0.0)), -np.log(0.05), atol=COST_STEP)
    between = [float(motion_cost((-4.0, miss)).mean()) for miss in (0.0, 0.3, 0.6, 0.9, 30.0)]
    assert between == sorted(set(between))
    np.testing.assert_allclose(motion_cost((30.0, 0.0), weight=0.5), -0.5 * np.log(0.05), atol=COST_STEP)


def test_a_flow_that_is_not_reliable_is_not_heard() -> None:
    np.testing.assert_array_equal(motion_cost((30.0, 0.0), reliable=False), 0.0)


def test_a_flow_is_not_heard_where_the_cameras_motion_explains_the_image() -> None:
    np.testing.assert_array_equal(motion_cost((30.0, 0.0), explained=True), 0.0)


def test_a_pixel_costs_more_the_farther_it_is_from_the_trajectories() -> None:
    config = configured(distance=2.0, near_px=20.0, fade_px=40.0, close_px=0.0, region_margin_px=100.0)
    positions = np.array([[80.0, 60.0]], np.float32)
    result = step(Layer(config, 1, "object"), 0, picture(), positions)
    for y in range(result.region.height):
        for x in range(result.region.width):
            away = np.hypot(x + result.region.x - 80, y + result.region.y - 60) / SCALE
            expected = 2.0 * min(max((away - 20.0) / 40.0, 0.0), 1.0)
            # Distances are told for four cells at once, and good to 2 %.
            assert abs(nats(result)[y, x] - 4.0 - expected) < 0.1 + 2.0 * 2**0.5 / (40.0 * SCALE)


def test_a_gap_between_the_trajectories_belongs_to_the_object() -> None:
    ring = grid(CAR, 2)
    inside = np.abs(ring - (80, 55)) < (9, 9)
    ring = ring[~inside.all(axis=1)]  # a hole of 18 px
    costs = {}
    for close in (0.0, 48.0):
        config = configured(distance=2.0, near_px=4.0, fade_px=20.0, close_px=close)
        result = step(Layer(config, 1, "object"), 0, picture(), ring)
        costs[close] = nats(result)[55 - result.region.y, 80 - result.region.x] - 4.0
    assert costs[0.0] > 1.0
    assert costs[48.0] == 0.0


def test_the_prior_is_the_last_posterior_moved_by_the_layers_own_motion() -> None:
    config = configured(prior=1.0, prior_floor=0.1, neutral_prior=0.5, region_margin_px=40.0)
    layer = Layer(config, 1, "object")
    first = step(layer, 0, picture(), grid(CAR), motion=(-3.0, 0.0))
    np.testing.assert_allclose(nats(first), 4.0 - np.log(0.5), atol=COST_STEP)  # neutral: new-born
    won = Region(70, 45, 20, 15)
    moved = grid(CAR) + np.array([3.0, 0.0], np.float32)
    second = step(layer, 1, picture(1), moved, published(0, owned(won), normaliser=60), motion=(-3.0, 0.0))
    own_share = np.exp((60.0 - first.cost) * COST_STEP)  # normalised posterior, below 1
    posterior = 0.5 * own_share + 0.5 * (owned(won)[first.region.slices] == 1)
    for y in range(second.region.height):
        for x in range(second.region.width):
            source_y = y + second.region.y - first.region.y
            source_x = x + second.region.x - 3 - first.region.x
            if 1 <= source_y < first.region.height - 1 and 1 <= source_x < first.region.width - 1:
                window = posterior[source_y - 1 : source_y + 2, source_x - 1 : source_x + 2]
                if np.ptp(window) == 0:  # inside or outside, the field's last digits do not matter
                    expected = 4.0 - np.log(max(window[0, 0], 0.1))
                    assert abs(nats(second)[y, x] - expected) <= 0.5 * COST_STEP + 1e-3
    centre = nats(second)[55 - second.region.y, 83 - second.region.x]
    outside = nats(second)[55 - second.region.y, 100 - second.region.x]
    assert centre < outside


def test_without_the_warp_samples_and_prior_stay_where_they_are() -> None:
    won, moved = Region(70, 45, 20, 15), grid(CAR) + np.array([3.0, 0.0], np.float32)
    left, right = (52, 71), (52, 91)  # only where it was, and only where it is by its own motion
    for warp in (True, False):
        weights = {**SILENT, "appearance": 1.0, "prior": 1.0, "region_margin_px": 40.0}
        config = Config.model_validate({"posterior": weights, "appearance": {"warp": warp}})
        layer = Layer(config, 1, "object")
        step(layer, 0, picture(), grid(CAR), motion=(-3.0, 0.0))
        before = published(0, owned(won), normaliser=60)
        second = step(layer, 1, picture(), moved, before, motion=(-3.0, 0.0))  # the picture has not moved
        corner = np.array([second.region.y, second.region.x])
        cost = {place: second.cost[tuple(place - corner)] for place in (left, right)}
        assert (cost[left] > cost[right]) == warp
        known = second.samples > 0
        assert known.sum() > 20
        assert (second.log_ratio[known].mean() > 0) == (not warp)


def test_a_prior_never_falls_below_its_floor() -> None:
    config = configured(prior=1.0, prior_floor=0.2)
    layer = Layer(config, 1, "object")
    step(layer, 0, picture(), grid(CAR))
    result = step(layer, 1, picture(), grid(CAR), published(0, owned(WHOLE, 0), normaliser=0))
    assert nats(result).max() <= 4.0 - np.log(0.2) + COST_STEP


def test_background_that_was_hidden_is_not_unlikely() -> None:
    config = configured(prior=1.0, prior_floor=0.1, neutral_prior=0.5)
    layer = Layer(config, 0, "background")
    step(layer, 0, picture(), grid(WHOLE))
    result = step(layer, 1, picture(), grid(WHOLE), published(0, owned(CAR), normaliser=0), rival=grid(CAR))
    own = nats(result)[slices_in(CAR, result.region)]
    assert own.min() > 4.0
    assert own.max() <= 4.0 - np.log(0.5) + COST_STEP


def test_an_object_is_cheap_where_its_motion_explains_the_image_and_dear_on_ground_that_stands() -> None:
    config = configured(photometric=1.0, photometric_cap=2.0, region_margin_px=40.0)
    layer = Layer(config, 1, "object")
    before, after = picture(), picture().copy()
    after[40:70, 66:106] = before[CAR.slices]  # by (6, 0)
    step(layer, 0, before, grid(CAR), motion=(-6.0, 0.0))
    moved = grid(CAR) + np.array([6.0, 0.0], np.float32)
    result = step(layer, 1, after, moved, published(0, owned(CAR)), motion=(-6.0, 0.0))
    whole = np.full(SHAPE, np.nan)
    whole[result.region.slices] = nats(result)
    np.testing.assert_allclose(whole[44:66, 72:100], 4.0 - 2.0, atol=COST_STEP)
    np.testing.assert_allclose(np.nanmedian(whole[32:37, 60:100]), 4.0 + 2.0, atol=COST_STEP)


def test_a_flow_that_contradicts_costs_each_kind_of_layer_its_own_floor() -> None:
    config = configured(motion=1.0, motion_floor=0.05, object_motion_floor=0.4)
    for layer, kind, floor in ((0, "background", 0.05), (1, "object", 0.4)):
        own = tracks(layer, grid(WHOLE))
        evidence = frame_of([own, tracks(2, grid(WHOLE))], 0, (30.0, 0.0), True)
        made = Layer(config, 0, "background") if kind == "background" else Layer(config, 1, "object")
        found = nats(made.step(evidence, None)) - 4.0
        np.testing.assert_allclose(found[20:100, 20:140], -np.log(floor), atol=COST_STEP)


# Its life


def test_its_velocity_is_the_median_motion_forwards_and_lasts_without_trajectories() -> None:
    layer = Layer(configured(), 1, "object")
    positions = grid(CAR)
    motions = np.tile(np.array([-2.0, 1.0], np.float32), (len(positions), 1))
    motions[:5] = 50.0
    own = LayerEvidence(1, "object", -1, positions, motions)
    result = layer.step(frame_of([own]), None)
    np.testing.assert_array_equal(result.velocity, [2.0, -1.0])
    after = step(layer, 1, picture(), np.zeros((0, 2), np.float32), published(0, owned(CAR)))
    np.testing.assert_array_equal(after.velocity, [2.0, -1.0])


def life(layer: Layer, first: int, last: int) -> list[bytes]:
    costs = []
    for t in range(first, last):
        previous = published(t - 1, owned(Region(60 + t, 40, 40, 30))) if t else None
        positions = grid(CAR) + np.array([t, 0], np.float32)
        image = np.roll(picture(), t, axis=1)
        one = step(layer, t, image, positions, previous, (-1.0, 0.0), rival=grid(CAR))
        costs.append(one.cost.tobytes() + one.log_ratio.tobytes() + one.samples.tobytes())
    return costs


@pytest.mark.parametrize("kind", ["object", "background"])
def test_it_goes_on_from_its_state(kind: str) -> None:
    config = configured(appearance=0.5, motion=0.5, prior=0.5, distance=0.5)
    one = Layer(config, 1, "object") if kind == "object" else Layer(config, 0, "background")
    life(one, 0, 5)
    resumed = Layer(config, one.layer, one.kind, copy.deepcopy(one.state))
    assert life(one, 5, 8) == life(resumed, 5, 8)


def test_what_is_given_is_only_read() -> None:
    layer = Layer(configured(appearance=1.0, motion=1.0, prior=1.0, distance=1.0), 1, "object")
    for t in range(3):
        image, positions, labels = picture(t), grid(CAR), owned(CAR).astype(np.uint16)
        previous = replace(published(t - 1, labels), labels=labels)
        for array in (image, positions, labels):
            array.flags.writeable = False
        step(layer, t, image, positions, previous if t else None)
    assert layer.state.last_frame == 2
