"""The segmenter: normaliser, pull of the trajectories, label map and summaries, against plain loops."""

from __future__ import annotations

from dataclasses import replace
from math import exp, log

import numpy as np
import pytest
from energy_fakes import MAX_COST, energy_of, slow_energy, weights_of_image
from joined_evidence import joined_evidence
from read_only import read_only

from mlbs_actors.appearance.fusion import fused_costs
from mlbs_actors.cells import mean_of_cells
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import FrameError
from mlbs_actors.graphcut.graph_cut import minimise
from mlbs_actors.messages import (
    BACKGROUND,
    COST_STEP,
    Array,
    FrameEvidence,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
    readonly,
)
from mlbs_actors.segmentation.contrast import COST_QUANTUM
from mlbs_actors.segmentation.mask_score import mask_score
from mlbs_actors.segmentation.segmenter import Segmenter, SegmenterState

SHAPE = (24, 32)
WHOLE = Region(0, 0, SHAPE[1], SHAPE[0])
#: Neither contrast nor label costs nor cleaning nor shadows: every pixel decides for itself.
PLAIN: dict[str, float] = {
    "contrast_strength": 0.0,
    "label_cost": 0.0,
    "speck_px": 0.0,
    "hole_px": 0.0,
    "shadow": 0.0,
    "contact_shadow": 0.0,
}


def configured(**segmentation: float) -> Config:
    return Config.model_validate({"segmentation": {**PLAIN, **segmentation}})


def kind_of(layer: int) -> LayerKind:
    return "background" if layer == BACKGROUND else "object"


def evidence_of(
    posteriors: list[LayerPosterior],
    frame_index: int = 0,
    tracks: dict[int, Array] | None = None,
    image: Array | None = None,
) -> FrameEvidence:
    image = frame() if image is None else image
    layers = []
    for one in posteriors:
        at = np.asarray((tracks or {}).get(one.layer, np.zeros((0, 2))), np.float32)
        layers.append(LayerEvidence(one.layer, one.kind, frame_index - 1, at, np.zeros_like(at)))
    return joined_evidence(
        layers,
        frame_index=frame_index,
        shape=image.shape[:2],
        camera=np.eye(3),
        flow=np.zeros((*SHAPE, 2), np.float32),
        flow_reliable=np.zeros(SHAPE, bool),
        unexplained=np.zeros(SHAPE, np.uint8),
        colours=mean_of_cells(image, posteriors[0].cell),
        retired=(),
        latency_frames=3,
        stage_ms={"flow": 1.5},
    )


def posterior(
    layer: int, cost: Array | int, region: Region = WHOLE, frame_index: int = 0, outside: int = 255
) -> LayerPosterior:
    full = np.full((region.height, region.width), cost, np.uint8) if isinstance(cost, int) else cost
    return LayerPosterior(
        layer=layer,
        frame_index=frame_index,
        kind=kind_of(layer),
        region=region,
        cell=1,
        cost=full,
        log_ratio=np.zeros(full.shape, np.int8),
        samples=np.zeros(full.shape, np.uint8),
        outside_cost=outside,
        confidence=0.5,
        velocity=np.array([layer, -layer], np.float32),
        stage_ms={"gabp": float(layer + 1), "posterior": 10.0 - layer},
    )


def random_posteriors(seed: int = 0) -> list[LayerPosterior]:
    rng = np.random.default_rng(seed)
    regions = [(0, WHOLE), (4, Region(3, 2, 20, 15)), (9, Region(10, 8, 22, 16))]
    return [
        posterior(layer, rng.integers(0, 200, (region.height, region.width)).astype(np.uint8), region)
        for layer, region in regions
    ]


def frame(seed: int = 1) -> Array:
    return np.random.default_rng(seed).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)


def stepped(
    segmenter: Segmenter, evidence: FrameEvidence, image: Array, posteriors: list[LayerPosterior]
) -> Segmentation:
    """One step, with arrays that cannot be written to."""
    return segmenter.step(readonly(evidence), read_only(image), [readonly(one) for one in posteriors])


def segmented(
    posteriors: list[LayerPosterior], config: Config, tracks: dict[int, Array] | None = None
) -> Segmentation:
    return stepped(Segmenter(config), evidence_of(posteriors, tracks=tracks), frame(), posteriors)


def cost_at(one: LayerPosterior, y: int, x: int) -> int:
    if has_a_say(one, y, x):
        return int(one.cost[y - one.region.y, x - one.region.x])
    return one.outside_cost


def has_a_say(one: LayerPosterior, y: int, x: int) -> bool:
    region = one.region
    return region.y <= y < region.y + region.height and region.x <= x < region.x + region.width


@pytest.mark.parametrize("seed", range(3))
def test_the_normaliser_is_that_of_plain_loops_where_an_object_has_a_say(seed: int) -> None:
    posteriors = random_posteriors(seed)
    result = segmented(posteriors, configured())
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            total = sum(exp(-COST_STEP * cost_at(one, y, x)) for one in posteriors if has_a_say(one, y, x))
            expected = min(max(-log(total) / COST_STEP, 0.0), 255.0)
            if any(has_a_say(one, y, x) for one in posteriors[1:]):
                assert abs(float(result.normaliser[y, x]) - expected) <= 0.5 + 1e-3
            else:  # the background's posterior, exp(normaliser − cost) but at most 1, is 1
                assert float(result.normaliser[y, x]) >= expected - 0.5 - 1e-3
    assert result.normaliser.dtype == np.uint8


@pytest.mark.parametrize("label_cost", [0.0, 30.0])
def test_groups_of_regions_are_labelled_as_one_problem_of_the_whole_frame(label_cost: float) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        regions = {0: WHOLE, 2: Region(1, 2, 9, 9), 5: Region(14, 0, 10, 8), 6: Region(20, 6, 9, 12)}
        posteriors = []
        for layer, region in regions.items():
            cost = rng.integers(20, 60, (region.height, region.width)).astype(np.uint8)
            if layer:
                cost[2:-2, 2:-2] -= 15
            posteriors.append(posterior(layer, cost, region))
        area = SHAPE[0] * SHAPE[1] / (640 * 480)
        config = configured(contrast_strength=1.0, contrast_scale=5e3, label_cost=label_cost / area)
        result = segmented(posteriors, config)
        unary = np.full((4, *SHAPE), MAX_COST, np.int32)
        for own, one in zip(unary, posteriors, strict=True):
            own[one.region.slices] = one.cost.astype(np.int32) * round(COST_STEP / COST_QUANTUM)
        label_costs = np.array([0, *[round(label_cost / COST_QUANTUM)] * 3])
        whole = energy_of(unary, weights_of_image(frame(), 1.0, 5e3), label_costs)
        labels = np.searchsorted(list(regions), result.labels)
        assert labels.any()
        expected = minimise(whole, Config().segmentation.most_cut_whole)
        assert slow_energy(labels, whole) == slow_energy(expected, whole)


def test_posteriors_of_cells_are_those_of_all_their_pixels() -> None:
    rng, side = np.random.default_rng(3), 2
    by_cells, by_pixels = [], []
    for layer, region in ((0, WHOLE), (4, Region(4, 2, 20, 14)), (9, Region(10, 8, 22, 16))):
        cost = rng.integers(0, 200, (region.height // side, region.width // side)).astype(np.uint8)
        by_pixels.append(posterior(layer, cost.repeat(side, axis=0).repeat(side, axis=1), region))
        unknown = np.zeros(cost.shape, np.int8), np.zeros_like(cost)
        by_cells.append(
            replace(by_pixels[-1], cell=side, cost=cost, log_ratio=unknown[0], samples=unknown[1])
        )
    config = configured(contrast_strength=1.0, contrast_scale=5e3)
    found, expected = segmented(by_cells, config), segmented(by_pixels, config)
    assert found.labels.any()
    np.testing.assert_array_equal(found.labels, expected.labels)
    told = np.s_[2:16, 4:24]
    np.testing.assert_array_equal(
        found.normaliser.repeat(side, axis=0).repeat(side, axis=1)[told], expected.normaliser[told]
    )
    assert found.layers == expected.layers


def test_every_pixel_gets_the_id_of_the_layer_that_costs_least() -> None:
    posteriors = random_posteriors()
    result = segmented(posteriors, configured())
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            costs = {one.layer: cost_at(one, y, x) for one in posteriors}
            assert costs[int(result.labels[y, x])] == min(costs.values())
    assert set(np.unique(result.labels).tolist()) == {0, 4, 9}
    assert result.labels.dtype == np.uint16


def test_colours_that_only_one_layer_knows_decide_only_where_they_are_contradicted() -> None:
    config = configured()
    known = np.full(SHAPE, 20, np.uint8)
    ratio = np.full(SHAPE, 40, np.int8)
    ratio[:, 16:] = -100
    other = replace(posterior(3, 40), log_ratio=ratio, samples=known)
    posteriors = [readonly(one) for one in (posterior(0, 41), other)]  # the first a little dearer
    result = segmented(posteriors, config)
    fused = fused_costs(
        posteriors, WHOLE, config.posterior.appearance, config.appearance.half_confidence_samples
    )
    np.testing.assert_array_equal(result.fallback, fused.fallback)
    assert (result.labels[:, :16] == 3).all()
    assert not result.labels[:, 16:].any()
    np.testing.assert_array_equal(result.labels, np.array([0, 3])[fused.cost.argmin(axis=0)])


def test_in_a_shadow_an_object_is_dearer_than_the_background_and_elsewhere_it_is_not() -> None:
    shape = (240, 320)
    image = np.full((*shape, 3), (120, 125, 130), np.uint8)
    image[80:120, 120:180] = (30, 30, 190)
    image[122:150, 115:185] //= 2
    region = Region(100, 60, 100, 110)
    x, y = np.meshgrid(np.arange(124, 178, 6), np.arange(84, 118, 6))
    at = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)
    background = posterior(0, 80, Region(0, 0, 320, 240), frame_index=1)
    posteriors = [background, posterior(1, 60, region, frame_index=1)]
    before = np.zeros(shape, np.uint16)
    before[region.slices] = 1
    maps = {}
    for strength in (0.0, 0.5):
        segmenter = Segmenter(
            configured(shadow=strength, track_cost=0.0),
            replace(SegmenterState.beginning(), next_frame=1, labels=before),
        )
        given = evidence_of(posteriors, 1, {1: at}, image)
        maps[strength] = stepped(segmenter, given, image, posteriors).labels
    assert (maps[0.0][region.slices] == 1).all()
    assert not maps[0.5][127:145, 122:178].any()
    assert (maps[0.5][82:118, 122:178] == 1).all()


def test_the_dark_strip_under_an_object_goes_to_the_background_and_is_no_part_of_its_summary() -> None:
    shape = (240, 320)
    image = np.full((*shape, 3), (120, 125, 130), np.uint8)
    car, strip = Region(120, 80, 60, 40), Region(126, 120, 48, 10)
    image[car.slices], image[strip.slices] = (30, 30, 190), 9
    cost = np.full((50, 60), 200, np.uint8)
    cost[:40], cost[40:, 6:54] = 0, 0
    posteriors = [posterior(0, 80, Region(0, 0, 320, 240)), posterior(7, cost, Region(120, 80, 60, 50))]
    at = np.array([[150.0, 100.0]], np.float32)
    results = {}
    for rise in (0.0, 0.25):
        given = evidence_of(posteriors, 0, {7: at}, image)
        results[rise] = stepped(Segmenter(configured(contact_shadow=rise)), given, image, posteriors)
    assert (results[0.0].labels[strip.slices] == 7).all()
    assert (results[0.25].labels[strip.slices] == 0).mean() > 0.8
    assert (results[0.25].labels[car.slices] == 7).all()
    assert results[0.25].layers[0].area == np.count_nonzero(results[0.25].labels == 7)


def test_each_box_of_claims_in_a_region_has_its_labels_and_its_summary() -> None:
    far_left, far_right = Region(3, 3, 7, 6), Region(20, 14, 9, 7)
    posteriors = [posterior(0, 80)]
    for layer, box in ((4, far_left), (6, None), (9, far_right)):  # one of them claims nothing
        cost = np.full(SHAPE, 200, np.uint8)
        if box is not None:
            cost[box.slices] = 10
        posteriors.append(posterior(layer, cost))
    result = segmented(posteriors, configured(track_cost=0.0))
    expected = np.zeros(SHAPE, np.uint16)
    expected[far_left.slices], expected[far_right.slices] = 4, 9
    np.testing.assert_array_equal(result.labels, expected)
    assert [(one.layer, one.region, one.area) for one in result.layers] == [
        (4, far_left, far_left.area),
        (9, far_right, far_right.area),
    ]
    assert [one.centroid for one in result.layers] == [(6.0, 5.5), (24.0, 17.0)]


def test_a_label_that_frees_two_others_of_their_costs_takes_their_place() -> None:
    # Beside a layer for the left half and one for the right half, one that is hardly worse everywhere: to use
    # it pays only if it frees both of their label costs at once.
    left, right = np.full((2, *SHAPE), 100, np.uint8)
    left[:, :16] = right[:, 16:] = 0
    posteriors = [posterior(0, 100), posterior(2, left), posterior(3, right), posterior(5, 1)]
    of_a_label = 2.5 * left[:, :16].size * COST_STEP / length_scale(*SHAPE) ** 2
    result = segmented(posteriors, configured(track_cost=0.0, label_cost=of_a_label))
    assert (result.labels == 5).all()
    assert [(one.layer, one.region, one.area) for one in result.layers] == [(5, WHOLE, WHOLE.area)]


def test_where_the_layers_cost_the_same_the_trajectories_decide() -> None:
    posteriors = [posterior(0, 40), posterior(3, 40)]
    background = np.array([[5.2, 6.1], [20.0, 20.0]])
    car = np.array([[9.6, 4.4], [31.4, 23.4], [-0.3, 0.2]])
    result = segmented(posteriors, configured(track_cost=1.0), {0: background, 3: car})
    assert result.labels[6, 5] == result.labels[20, 20] == 0
    assert result.labels[4, 10] == result.labels[23, 31] == result.labels[0, 0] == 3


def test_trajectories_overrule_a_posterior_that_says_less_and_not_one_that_says_more() -> None:
    track = np.array([[10.0, 10.0]])
    pull = 1.0  # for its own label and against the others: 2 nats, 32 quanta
    for quanta, label in ((30, 3), (34, 0)):
        posteriors = [posterior(0, 40), posterior(3, 40 + quanta)]
        assert segmented(posteriors, configured(track_cost=pull), {3: track}).labels[10, 10] == label
    posteriors = [posterior(0, 40), posterior(3, 40 + 60)]
    twice = np.array([[10.0, 10.0], [10.3, 9.8]])
    assert segmented(posteriors, configured(track_cost=pull), {3: twice}).labels[10, 10] == 3


def test_a_layer_owns_nothing_outside_its_region() -> None:
    region = Region(8, 6, 10, 9)
    result = segmented([posterior(0, 100), posterior(2, 0, region)], configured())
    expected = np.zeros(SHAPE, int)
    expected[region.slices] = 2
    np.testing.assert_array_equal(result.labels, expected)


def test_a_label_whose_cost_outweighs_its_evidence_disappears() -> None:
    posteriors = [posterior(0, 16), posterior(5, 0, Region(4, 4, 3, 3))]  # 9 pixels, 1 nat each
    area = SHAPE[0] * SHAPE[1] / (640 * 480)  # label costs are stated for 640×480
    assert 5 in segmented(posteriors, configured(label_cost=8.0 / area)).labels
    gone = segmented(posteriors, configured(label_cost=10.0 / area))
    assert not gone.labels.any()
    assert gone.layers == ()


def test_a_label_that_has_been_there_for_long_costs_nothing() -> None:
    area = SHAPE[0] * SHAPE[1] / (640 * 480)
    config = configured(label_cost=10.0 / area, label_cost_frames=3)
    segmenter = Segmenter(config)
    for index in range(6):
        size = 4 if index in (0, 3) else 3  # 16 or 9 pixels, 1 nat each
        object_ = posterior(5, 0, Region(4, 4, size, size), index)
        given = [posterior(0, 16, frame_index=index), object_]
        result = stepped(segmenter, evidence_of(given, index), frame(), given)
        assert (5 in result.labels) == (index in (0, 3, 4, 5))


def test_the_published_map_is_cleaned() -> None:
    cost = np.full(SHAPE, 200, np.uint8)
    cost[5:15, 5:15] = 0
    cost[8, 8] = 200  # a pinhole
    cost[20, 25] = 0  # a speck
    posteriors = [posterior(0, 100), posterior(1, cost)]
    area = SHAPE[0] * SHAPE[1] / (640 * 480)
    raw = segmented(posteriors, configured()).labels
    cleaned = segmented(posteriors, configured(speck_px=2.5 / area, hole_px=2.5 / area)).labels
    assert (raw[8, 8], raw[20, 25]) == (0, 1)
    assert (cleaned[8, 8], cleaned[20, 25]) == (1, 0)


def test_outlines_follow_the_contrast() -> None:
    image = np.full((*SHAPE, 3), 40, np.uint8)
    image[:, 17:] = 200
    cost = np.full(SHAPE, 100, np.uint8)
    cost[:, 14:] = 96  # the posterior's own border lies three px off the edge of the image
    posteriors = [posterior(0, 98), posterior(1, cost)]
    config = configured(contrast_strength=3.0, contrast_scale=300.0)
    tracks = {0: np.array([[2.0, y] for y in range(24)]), 1: np.array([[30.0, y] for y in range(24)])}
    result = stepped(Segmenter(config), evidence_of(posteriors, 0, tracks, image), image, posteriors)
    np.testing.assert_array_equal(result.labels, np.repeat([[0, 1]], 24, axis=0).repeat([17, 15], axis=1))


def test_the_summaries_are_those_of_plain_loops() -> None:
    posteriors = random_posteriors(2)
    result = segmented(posteriors, configured())
    assert [one.layer for one in result.layers] == [4, 9]
    for summary in result.layers:
        own = [
            (y, x) for y in range(SHAPE[0]) for x in range(SHAPE[1]) if result.labels[y, x] == summary.layer
        ]
        ys, xs = zip(*own, strict=True)
        one = next(one for one in posteriors if one.layer == summary.layer)
        certain = [
            min(exp(COST_STEP * (float(result.normaliser[y, x]) - cost_at(one, y, x))), 1.0) for y, x in own
        ]
        assert summary.area == len(own)
        assert summary.region == Region(min(xs), min(ys), max(xs) - min(xs) + 1, max(ys) - min(ys) + 1)
        assert summary.centroid == pytest.approx((np.mean(xs), np.mean(ys)))
        assert summary.confidence == pytest.approx(np.mean(certain))
        share = len(own) / (SHAPE[0] * SHAPE[1])
        assert summary.score == pytest.approx(mask_score(float(np.mean(certain)), one.confidence, share))
        assert summary.velocity == (summary.layer, -summary.layer)
        assert summary.kind == "object"


def test_the_layer_other_keeps_its_kind() -> None:
    shared = replace(posterior(7, 0), kind="other")
    result = segmented([posterior(0, 50), shared], configured())
    assert [(one.layer, one.kind) for one in result.layers] == [(7, "other")]


def test_a_layer_without_pixels_has_no_summary() -> None:
    result = segmented([posterior(0, 0), posterior(1, 200)], configured())
    assert result.layers == ()
    empty = segmented([posterior(0, 0), posterior(1, 0, Region(0, 0, 0, 0))], configured())
    assert not empty.labels.any()


def test_the_background_alone_labels_everything() -> None:
    result = segmented([posterior(0, 130)], configured(contrast_strength=1.0, label_cost=20.0, speck_px=50.0))
    assert not result.labels.any()
    assert not result.fallback.any()
    np.testing.assert_array_equal(result.normaliser, 255)


def test_what_the_evidence_knows_is_passed_on() -> None:
    result = segmented([replace(posterior(0, 0), velocity=np.array([1.5, -2.0]))], configured())
    assert result.frame_index == 0
    assert result.latency_frames == 3
    assert result.camera_motion == (1.5, -2.0)


def test_of_layers_side_by_side_the_slowest_counts() -> None:
    stages = segmented(random_posteriors(), configured()).stage_ms
    assert (stages["flow"], stages["gabp"], stages["posterior"]) == (1.5, 10.0, 10.0)


def test_a_frame_out_of_order_is_refused_and_changes_nothing() -> None:
    segmenter = Segmenter(configured())
    posteriors = random_posteriors()
    with pytest.raises(FrameError, match=r"due for frame 0; it was given frame 1 .* last snapshot\."):
        stepped(segmenter, evidence_of(posteriors, 1), frame(), posteriors)
    first = stepped(segmenter, evidence_of(posteriors, 0), frame(), posteriors)
    with pytest.raises(FrameError, match="due for frame 1; it was given frame 0"):
        stepped(segmenter, evidence_of(posteriors, 0), frame(), posteriors)
    with pytest.raises(FrameError, match="due for frame 1"):  # the right layers of the wrong frame
        stepped(segmenter, evidence_of(posteriors, 1), frame(), posteriors)
    later = [replace(one, frame_index=1) for one in posteriors]
    second = stepped(segmenter, evidence_of(posteriors, 1), frame(), later)
    np.testing.assert_array_equal(first.labels, second.labels)


@pytest.mark.parametrize("given", [[0, 4], [0, 9, 4], [0, 4, 9, 9], []])
def test_posteriors_that_are_not_those_of_the_live_layers_are_refused(given: list[int]) -> None:
    posteriors = random_posteriors()
    by_id = {one.layer: one for one in posteriors}
    with pytest.raises(FrameError, match="restart the stream from its last snapshot"):
        stepped(Segmenter(configured()), evidence_of(posteriors), frame(), [by_id[layer] for layer in given])


def test_what_is_given_is_only_read() -> None:
    config = configured(contrast_strength=1.0, label_cost=20.0, speck_px=50.0, hole_px=200.0)
    posteriors, image = [readonly(one) for one in random_posteriors()], read_only(frame())
    assert Segmenter(config).step(readonly(evidence_of(posteriors)), image, posteriors).labels.any()


def test_the_published_map_is_the_one_kept_for_the_next_frame() -> None:
    segmenter = Segmenter(configured())
    result = stepped(segmenter, evidence_of(random_posteriors()), frame(), random_posteriors())
    np.testing.assert_array_equal(segmenter.state.labels, result.labels)
    assert segmenter.state.next_frame == 1


def test_a_published_result_cannot_be_written_to_since_the_layers_read_it_back() -> None:
    posteriors = random_posteriors()
    published = stepped(Segmenter(configured()), evidence_of(posteriors, 0), frame(), posteriors)
    assert not published.labels.flags.writeable
    assert not published.normaliser.flags.writeable
    assert not published.fallback.flags.writeable
