"""Every figure pinned by tiny masks whose values are worked out by hand beside them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array, Region
from orchestrator.evaluation.frame_statistics import frame_statistics
from orchestrator.evaluation.metrics import (
    false_area,
    jaccard,
    match_objects,
    multi_label,
    multi_label_matlab,
    object_level,
    two_label,
)
from orchestrator.evaluation.overlap import FrameOverlap, count_overlap
from orchestrator.evaluation.sequence_scorer import SequenceScorer
from orchestrator.evaluation.track_metrics import (
    davis_tracks,
    entry_delays,
    id_switches,
    ids_on,
    moving_objects,
    shared_ids,
    track_j,
)


def row(text: str) -> Array:
    """One image row, a value a word."""
    return np.array([[int(value) for value in text.split()]], np.int32)


def overlap(truth: str, labels: str, index: int = 0) -> FrameOverlap:
    return count_overlap(row(labels), row(truth).astype(np.uint8), index)


# Object 1 has 4 px, object 2 has 2 px. Label 5 finds 3 px of object 1 (P 1, R 3/4, F 6/7), label 6 one px of
# object 2 and one px of background (P 1/2, R 1/2, F 1/2), label 7 is one px of background.
TWO_OBJECTS = ("1 1 1 1 2 2 0 0 0 0", "5 5 5 0 6 0 6 7 0 0")


def test_two_label_figures_count_any_label_as_moving() -> None:
    found = overlap("0 0 1 1 2 2", "0 9 9 9 3 0")  # 3 px right, 1 false, 1 missed
    assert two_label(found) == pytest.approx((3 / 4, 3 / 4, 3 / 4))
    assert jaccard(found) == pytest.approx(3 / 5)


def test_nothing_on_both_sides_scores_one() -> None:
    nothing = overlap("0 0 0", "0 0 0")
    assert two_label(nothing).f == 1
    assert jaccard(nothing) == 1


@pytest.mark.parametrize(("truth", "labels"), [("0 1 1", "0 0 0"), ("0 0 0", "4 0 0")])
def test_one_empty_side_scores_zero(truth: str, labels: str) -> None:
    one_sided = overlap(truth, labels)
    assert two_label(one_sided).f == 0
    assert jaccard(one_sided) == 0
    assert multi_label(one_sided).f == 0


def test_pixels_of_value_255_belong_to_no_region_of_either_side() -> None:
    judged = overlap("0 1 1 255 255 255", "0 5 5 5 8 0")
    assert two_label(judged) == (1, 1, 1)
    assert jaccard(judged) == 1
    assert multi_label(judged) == (1, 1, 1)  # label 8, only there, is no extra region
    assert multi_label_matlab(judged) == (1, 1, 1)


def test_multi_f_counts_an_extra_region_as_a_failure() -> None:
    scores = multi_label(overlap(*TWO_OBJECTS))
    assert scores.f == pytest.approx((6 / 7 + 1 / 2 + 0) / 3)
    assert scores.precision == pytest.approx((1 + 1 / 2 + 1) / 3)
    assert scores.recall == pytest.approx((3 / 4 + 1 / 2 + 0) / 3)


def test_object_f_leaves_extra_regions_out() -> None:
    scores = object_level(overlap(*TWO_OBJECTS))
    assert scores.f == pytest.approx((6 / 7 + 1 / 2) / 2)
    assert scores.precision == pytest.approx((1 + 1 / 2) / 2)
    assert scores.recall == pytest.approx((3 / 4 + 1 / 2) / 2)


def test_a_lost_object_scores_zero_in_both_multi_label_figures() -> None:
    lost = overlap("1 1 2 2 0", "5 5 0 0 0")
    assert multi_label(lost) == pytest.approx((1, 1 / 2, 1 / 2))
    assert object_level(lost) == pytest.approx((1, 1 / 2, 1 / 2))


def test_only_one_of_two_labels_on_one_object_counts() -> None:
    halves = overlap("1 1 1 1", "5 5 6 6")  # each half: F = 2·2/(2+4) = 2/3
    assert multi_label(halves).f == pytest.approx((2 / 3 + 0) / 2)
    assert object_level(halves).f == pytest.approx(2 / 3)


def test_the_assignment_maximises_the_sum_and_not_the_best_pair() -> None:
    # F(1,5) = 6/9 is the best pair, but F(1,6) + F(2,5) = 4/7 + 2/5 is the best sum.
    crossed = overlap("1 1 1 1 1 2", "5 5 5 6 6 5")
    assert match_objects(crossed) == {1: 6, 2: 5}
    assert object_level(crossed).f == pytest.approx((4 / 7 + 2 / 5) / 2)


def test_pairs_without_common_pixels_are_not_matched() -> None:
    assert match_objects(overlap("1 1 0 0", "0 0 5 5")) == {}
    assert multi_label(overlap("1 1 0 0", "0 0 5 5")) == (1, 0, 0)  # one lost, one extra


def test_multi_f_matlab_weighs_objects_by_the_square_of_p_plus_r() -> None:
    # Σ 2PR(P+R) = 2·1·¾·1¾ + 2·½·½·1 = 3.125; Σ (P+R)² = 1.75² + 1² = 4.0625
    scores = multi_label_matlab(overlap(*TWO_OBJECTS))
    assert scores.f == pytest.approx(3.125 / 4.0625)
    assert scores.precision == pytest.approx((1 + 1 / 2) / 2)
    assert scores.recall == pytest.approx((3 / 4 + 1 / 2) / 2)


@pytest.mark.parametrize("background", ["0 0 0 0", "0 0 0 9"])
def test_multi_f_matlab_gives_an_unmatched_object_full_precision_and_no_recall(background: str) -> None:
    # Object 1: P = R = 1, so 4 and 4; object 2: P = 1, R = 0, so 0 and 1. An extra label changes nothing.
    lost = overlap("1 1 1 1 2 2 0 0 0 0", f"5 5 5 5 0 0 {background}")
    assert multi_label_matlab(lost) == pytest.approx((1, 1 / 2, 4 / 5))


def test_multi_f_matlab_lets_an_object_take_the_background_label() -> None:
    # Overlap is largest with background → 7 (3 px) and object 1 → label 0 (2 px): P = 2/3, R = 2/3.
    swapped = overlap("1 1 1 0 0 0 0", "0 0 7 7 7 7 0")
    assert multi_label_matlab(swapped) == pytest.approx((2 / 3, 2 / 3, 2 / 3))


def test_multi_f_matlab_of_a_frame_without_objects_is_undefined() -> None:
    assert all(math.isnan(value) for value in multi_label_matlab(overlap("0 0", "0 3")))


def test_pixel_counts_equal_those_of_a_loop() -> None:
    rng = np.random.default_rng(3)
    truth = rng.choice(np.array([0, 1, 4, 255], np.uint8), (13, 17))
    labels = rng.choice(np.array([0, 2, 300, 40_000], np.uint16), (13, 17))
    counted = count_overlap(labels, truth)
    assert counted.objects.tolist() == [1, 4]
    assert counted.labels.tolist() == [2, 300, 40_000]
    for i, truth_id in enumerate([0, 1, 4]):
        for j, label in enumerate([0, 2, 300, 40_000]):
            slow = sum(
                int(t == truth_id and value == label)
                for t, value in zip(truth.flat, labels.flat, strict=True)
            )
            assert counted.counts[i, j] == slow


def test_the_assignment_equals_the_best_of_all_permutations() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        counted = count_overlap(rng.integers(0, 5, (5, 5)), rng.integers(0, 4, (5, 5)).astype(np.uint8))
        inside = counted.counts[1:, 1:]
        areas = counted.counts[1:].sum(axis=1)[:, None] + counted.counts[:, 1:].sum(axis=0)[None]
        f = np.pad(2 * inside / areas, ((0, 0), (0, len(counted.objects))))  # a free column: unmatched
        best = max(
            sum(f[i, column] for i, column in enumerate(columns))
            for columns in itertools.permutations(range(f.shape[1]), f.shape[0])
        )
        assert object_level(counted).f == pytest.approx(best / len(counted.objects))


def test_masks_of_another_size_than_their_truth_are_refused() -> None:
    with pytest.raises(FrameError, match="frame 4"):
        count_overlap(np.zeros((2, 3), np.int32), np.zeros((3, 2), np.uint8), 4)


def test_identity_switches_compare_with_the_label_last_matched() -> None:
    # Object 1: 5, lost, 5 (no switch), 6 (one), 5 (two); object 2 keeps 9.
    labels = ["5 5 9 9", "0 0 9 9", "5 5 9 9", "6 6 9 9", "5 5 9 9"]
    assert id_switches(overlap("1 1 2 2", text) for text in labels) == 2


def over_frames(*frames: tuple[str, str]) -> list[FrameOverlap]:
    """Overlaps of frames given as (truth, labels)."""
    return [overlap(truth, labels, index) for index, (truth, labels) in enumerate(frames)]


def test_track_j_follows_one_label_through_all_frames() -> None:
    # IoU of label 5: 1, 1/2, and 0 where 6 has taken its place; of label 6: 0, 0 (not there, 0 as well), 1.
    frames = over_frames(("1 1 0", "5 5 0"), ("1 1 0", "5 0 0"), ("1 1 0", "6 6 0"))
    assert track_j(frames) == pytest.approx((1 + 1 / 2 + 0) / 3)


def test_track_j_matches_for_the_best_sum_over_the_sequence_and_not_in_each_frame() -> None:
    # Labels 5 and 6 change places for one frame of four: each keeps its object, with 0 in that frame.
    kept, changed = ("1 1 2 2", "5 5 6 6"), ("1 1 2 2", "6 6 5 5")
    assert track_j(over_frames(kept, kept, changed, kept)) == pytest.approx(3 / 4)


def test_track_j_leaves_out_frames_with_neither_and_counts_zero_where_one_is_alone() -> None:
    both, neither = ("1 1", "5 5"), ("0 0", "0 0")
    assert track_j(over_frames(both, neither, neither)) == 1
    assert track_j(over_frames(both, ("1 1", "0 0"))) == 1 / 2  # the object alone
    assert track_j(over_frames(both, ("0 0", "5 5"))) == 1 / 2  # the label alone


def test_track_j_of_an_object_without_a_label_is_zero_and_surplus_labels_do_not_count() -> None:
    assert track_j(over_frames(("1 1 2 2 0", "5 5 0 0 9"))) == 1 / 2
    assert track_j(over_frames(("1 1 2 2 0", "0 0 0 0 0"))) == 0


def test_ids_on_an_object_lie_there_with_half_of_their_pixels_in_three_frames() -> None:
    truth = "1 1 1 1 1 2 2 0 0 0"
    # On object 1: 5, and 6 with one of its two pixels. Not on it: 7 with one of its three, and 8, which lies
    # there for two frames only. Object 2 has no label.
    three, two = (truth, "5 5 0 6 7 0 0 6 7 7"), (truth, "5 5 8 6 7 0 0 6 7 7")
    assert ids_on(over_frames(two, three, two)) == (2 + 0) / 2


def test_an_object_shares_its_label_if_most_of_another_one_that_is_found_has_it_too() -> None:
    truth = "1 1 1 2 2 2 3 3 3 0"
    apart, joined, mostly = "5 5 5 6 6 6 7 7 7 0", "5 5 5 5 5 5 7 7 7 5", "5 5 6 5 5 5 6 7 7 0"
    assert shared_ids(over_frames((truth, apart))) == 0
    assert shared_ids(over_frames((truth, joined))) == 2 / 3
    assert shared_ids(over_frames((truth, apart), (truth, joined), (truth, mostly))) == 4 / 9
    # An object of which too little is labelled is not found; of an unknown label nobody else has any.
    assert shared_ids(over_frames(("1 1 1 1 2 0", "5 0 0 0 5 5"))) == 0
    assert math.isnan(shared_ids(over_frames((truth, "0 0 0 0 0 0 0 0 0 8"))))


def test_false_area_is_what_is_labelled_and_background_among_the_judged_pixels() -> None:
    assert false_area(overlap("0 0 0 1 1 255 255 0", "5 6 0 5 0 5 0 0")) == 2 / 6
    assert false_area(overlap("255 255", "5 0")) == 0


def test_figures_of_whole_sequences_leave_pixels_out_that_are_not_judged() -> None:
    frames = over_frames(*[("1 1 255 255 255", "5 5 5 5 5")] * 3)
    assert track_j(frames) == 1
    assert ids_on(frames) == 1


def test_figures_of_whole_sequences_are_unknown_without_objects() -> None:
    assert math.isnan(track_j(over_frames(("0 0", "0 5"))))
    assert math.isnan(ids_on(over_frames(("0 0", "0 5"))))


@pytest.mark.parametrize("seed", range(20))
def test_figures_of_whole_sequences_equal_those_of_loops_over_masks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = [rng.choice([0, 0, 1, 2, 4, 255], (4, 5)) * (rng.random() < 0.8) for _ in range(6)]
    labels = [np.where(rng.random((4, 5)) < 0.6, t % 255, rng.integers(0, 4, (4, 5))) * 3 for t in truth]
    objects = sorted(set(np.concatenate(truth).ravel().tolist()) - {0, 255})
    ids = sorted(set(np.concatenate(labels).ravel().tolist()) - {0})
    means: dict[tuple[int, int], float] = {}
    on: dict[tuple[int, int], int] = {}
    for truth_id, label in itertools.product(objects, ids):
        ious, frames_on = [], 0
        for true, found in zip(truth, labels, strict=True):
            a, b = (true == truth_id)[true != 255], (found == label)[true != 255]
            if (a | b).any():
                ious.append((a & b).sum() / (a | b).sum())
            frames_on += bool(b.any() and (a & b).sum() >= b.sum() / 2)
        means[truth_id, label] = np.mean(ious) if ious else 0
        on[truth_id, label] = frames_on
    choices = itertools.permutations([*ids, *(None for _ in objects)], len(objects))
    best = max(
        sum(means[pair] for pair in zip(objects, chosen, strict=True) if pair[1] is not None)
        for chosen in choices
    )
    counted = [count_overlap(found, true.astype(np.uint8)) for found, true in zip(labels, truth, strict=True)]
    assert track_j(counted) == pytest.approx(best / len(objects))
    assert ids_on(counted) == sum(count >= 3 for count in on.values()) / len(objects)
    holding = sharing = 0
    for lab, true in zip(labels, truth, strict=True):
        mains = []
        for one in sorted(set(true[(true > 0) & (true < 255)].tolist())):
            own = lab[true == one]
            sizes = {
                label: int((own == label).sum()) for label in sorted(set(lab[true < 255].tolist()) - {0})
            }
            main = max(sizes, key=lambda label: sizes[label], default=0)
            if main and sizes[main] >= 0.3 * own.size:
                mains.append(main)
        holding += len(mains)
        sharing += sum(mains.count(main) > 1 for main in mains)
    assert shared_ids(counted) == pytest.approx(sharing / holding)


def score_extra(lives: list[tuple[str, str | None]]) -> SequenceScorer:
    scorer = SequenceScorer()
    for index, (labels, truth) in enumerate(lives):
        scorer.add(index, row(labels), None if truth is None else row(truth).astype(np.uint8))
    return scorer


def test_extra_layers_live_three_frames_and_lie_mostly_off_the_truth() -> None:
    truth = "1 1 1 1 0 0 0 0 0 0"
    # Over the frames: 8 has 1 of 4 px on the object in each of 3 frames: extra. 7 has 1 of 2: not.
    # 9 lies off it, but for two frames only.
    frames = ["8 0 0 7 7 8 8 8 0 9", "8 0 0 7 7 8 8 8 0 9", "8 0 0 7 7 8 8 8 0 0", "0 0 0 0 0 0 0 0 0 0"]
    score = score_extra([(labels, truth) for labels in frames]).score()
    assert [extra.layer for extra in score.extras] == [8]
    assert score.extra_layers == 100 * 1 / 4
    extra = score.extras[0]
    assert (extra.first_frame, extra.frames, extra.on_truth) == (0, 3, 1 / 4)


def test_the_life_of_an_extra_layer_counts_frames_without_truth() -> None:
    score = score_extra([("0 6", "0 0"), ("0 6", None), ("0 6", None)]).score()
    assert [(extra.layer, extra.frames) for extra in score.extras] == [(6, 3)]
    assert score.frames == 3
    assert score.all_frames.frames == 1


def test_a_layer_that_is_never_judged_is_not_called_extra() -> None:
    assert score_extra([("0 6", None)] * 3 + [("0 6", "0 255")]).score().extras == ()


def test_the_example_of_an_extra_layer_is_where_it_is_largest() -> None:
    score = score_extra([("4 0 0 0", "0 0 0 0"), ("0 4 4 0", "0 0 0 0"), ("0 0 0 4", "0 0 0 0")]).score()
    assert score.extras[0].example_frame == 1
    assert score.extras[0].region == Region(1, 0, 2, 1)
    assert score.extras[0].mask.tolist() == [[True, True]]


def scene_with_square(side: int, extra_pixels: int, speed: float) -> tuple[Array, Array]:
    """A square of truth 3 that moves right by ``speed`` while its surroundings move down by 2 px/frame."""
    truth = np.zeros((60, 60), np.uint8)
    truth[10 : 10 + side, 10 : 10 + side] = 3
    truth[10 + side, 10 : 10 + extra_pixels] = 3
    flow = np.zeros((60, 60, 2), np.float32)
    flow[..., 1] = 2.0
    flow[truth == 3, 0] = speed
    return truth, flow


def test_an_object_enters_with_400_pixels_and_one_pixel_a_frame_against_its_surroundings() -> None:
    assert moving_objects(*scene_with_square(20, 0, 1.0)) == [3]
    assert moving_objects(*scene_with_square(20, 0, 0.99)) == []
    assert moving_objects(*scene_with_square(19, 38, 1.0)) == []  # 19·19 + 38 = 399 px


def test_motion_shared_with_the_surroundings_is_no_entry() -> None:
    truth, flow = scene_with_square(20, 0, 0.0)
    flow += 5.0
    assert moving_objects(truth, flow) == []


def test_entry_delay_runs_from_the_entry_to_the_first_iou_of_one_half() -> None:
    truth = "1 1 1 1 2 2 0"
    frames = [
        overlap(truth, "5 5 5 5 0 0 0", 0),  # before object 1 entered: does not count
        overlap(truth, "0 0 0 5 0 0 0", 1),  # IoU 1/4
        overlap(truth, "5 6 0 0 0 0 0", 2),  # two labels of IoU 1/4 are not one of 1/2
        overlap(truth, "5 5 0 0 0 0 0", 3),  # IoU 1/2
        overlap(truth, "5 5 5 0 6 0 6", 4),  # object 2: IoU 1/3
    ]
    assert entry_delays(frames, {1: 1, 2: 0}) == {1: 2, 2: None}


def test_the_scorer_finds_entries_from_the_exact_motion() -> None:
    scorer = SequenceScorer()
    truth, flow = scene_with_square(20, 0, 3.0)
    scorer.add(0, np.zeros((60, 60), np.uint16), truth)
    for index in (1, 2, 3):
        found = np.where(truth == 3, 11, 0) if index == 3 else np.zeros((60, 60), int)
        scorer.add(index, found, truth, flow)
    assert scorer.score().entry_delay == {3: 2}


def test_ranges_of_frames_are_scored_apart() -> None:
    # 12 frames: right in frames 0–4, empty afterwards; the last has no object and is right again.
    scorer = SequenceScorer()
    for index in range(12):
        truth = row("0 0" if index == 11 else "0 1").astype(np.uint8)
        scorer.add(index, row("0 7" if index < 5 else "0 0"), truth)
    score = scorer.score()
    assert score.all_frames.two_label_f == pytest.approx(6 / 12)
    assert score.first_ten.two_label_f == pytest.approx(5 / 10)
    assert score.after_start.two_label_f == pytest.approx(1 / 7)
    assert score.davis.frames == 10  # without the first and the last
    assert score.davis.j == pytest.approx(4 / 10)
    assert score.all_frames.object_f == pytest.approx(5 / 11)  # frame 11 has no object
    assert score.all_frames.multi_f == pytest.approx(5 / 11)
    assert score.all_frames.multi_f_matlab == pytest.approx(5 / 11)


def test_the_sequence_figures_are_means_of_the_frames_figures() -> None:
    scorer = SequenceScorer()
    for index in range(2):  # frame 0 as in TWO_OBJECTS, frame 1 perfect
        labels = TWO_OBJECTS[1] if index == 0 else TWO_OBJECTS[0]
        scorer.add(index, row(labels), row(TWO_OBJECTS[0]).astype(np.uint8))
    whole = scorer.score().all_frames
    assert whole.precision == pytest.approx((4 / 6 + 1) / 2)
    assert whole.recall == pytest.approx((4 / 6 + 1) / 2)
    assert whole.two_label_f == pytest.approx((4 / 6 + 1) / 2)
    assert whole.j == pytest.approx((4 / 8 + 1) / 2)
    assert whole.multi_precision == pytest.approx((5 / 6 + 1) / 2)
    assert whole.multi_recall == pytest.approx((5 / 12 + 1) / 2)
    assert whole.multi_f == pytest.approx((19 / 42 + 1) / 2)
    assert whole.object_f == pytest.approx((19 / 28 + 1) / 2)
    assert whole.multi_precision_matlab == pytest.approx((3 / 4 + 1) / 2)
    assert whole.multi_recall_matlab == pytest.approx((5 / 8 + 1) / 2)
    assert whole.multi_f_matlab == pytest.approx((10 / 13 + 1) / 2)


def test_figures_without_frames_are_unknown_and_not_zero() -> None:
    empty = SequenceScorer().score()
    assert empty.frames == 0
    assert math.isnan(empty.all_frames.two_label_f)
    assert math.isnan(empty.all_frames.object_f)


def box_frames(truths: list[dict[int, int]], labels: list[dict[int, int]]) -> list[FrameOverlap]:
    """Frames of 40×200 px; each region is a box of 20×10 px at the given column."""

    def picture(boxes: dict[int, int]) -> Array:
        drawn = np.zeros((40, 200), np.uint8)
        for value, column in boxes.items():
            drawn[10:30, column : column + 10] = value
        return drawn

    return [
        count_overlap(picture(found).astype(np.int32), picture(wanted), index)
        for index, (wanted, found) in enumerate(zip(truths, labels, strict=True))
    ]


def means_of_tracks(frames: list[FrameOverlap]) -> list[tuple[int, int | None, float, float]]:
    return [(one.truth_id, one.label, one.j.mean, one.f.mean) for one in davis_tracks(frames)]


def test_davis_tracks_match_one_label_to_each_object_over_all_frames() -> None:
    # Label 6 is on object 1 in one frame, label 5 in two; label 6 is free for object 2, which it is never on.
    frames = box_frames([{1: 10, 2: 100}] * 3, [{5: 10}, {5: 10}, {6: 10}])
    assert means_of_tracks(frames) == [(1, 5, pytest.approx(2 / 3), pytest.approx(2 / 3)), (2, 6, 0, 0)]


def test_davis_tracks_count_one_for_a_frame_with_neither_and_zero_with_only_one() -> None:
    frames = box_frames([{1: 10}, {}, {}, {1: 10}], [{5: 10}, {}, {5: 60}, {}])
    assert means_of_tracks(frames) == [(1, 5, 0.5, 0.5)]


def test_davis_tracks_match_an_object_without_a_label_to_nothing() -> None:
    frames = box_frames([{1: 10, 2: 100}, {1: 10}], [{5: 10}, {5: 10}])
    assert means_of_tracks(frames) == [(1, 5, 1, 1), (2, None, 0.5, 0.5)]
    assert davis_tracks(frames)[1].j_and_f == 0.5


def test_davis_tracks_have_the_recall_and_decay_of_each_frame_they_count() -> None:
    # Lost in the second half, in which a frame with neither counts as found.
    frames = box_frames([{1: 10}] * 7 + [{}], [{5: 10}] * 4 + [{}] * 4)
    (track,) = davis_tracks(frames)
    assert track.j == frame_statistics([1, 1, 1, 1, 0, 0, 0, 1]) == track.f


def test_davis_tracks_choose_by_the_mean_of_both_measures() -> None:
    # Label 5 has the larger J, 6 against 4 of the object's 10 px, label 6 by far the larger F.
    counts = np.array([[100, 0, 0], [0, 6, 4]])
    frame = FrameOverlap(0, np.array([1]), np.array([5, 6]), counts, 1.0, np.array([[0.1, 0.9]]))
    assert means_of_tracks([frame]) == [(1, 6, 0.4, 0.9)]


def test_the_protocol_of_davis_leaves_the_first_and_last_frame_out() -> None:
    scorer = SequenceScorer()
    box = np.zeros((40, 40), np.uint8)
    box[10:30, 10:30] = 1
    nothing = np.zeros((40, 40), np.int32)
    for index, labels in enumerate([nothing, box.astype(np.int32), nothing, nothing]):
        scorer.add(index, labels, box)
    score = scorer.score()
    assert (score.davis.j, score.davis.f, score.davis.j_and_f) == (0.5, 0.5, 0.5)
    assert (score.all_frames.j, score.all_frames.f) == (0.25, 0.25)
    assert [(one.index, one.j, one.labels, one.matches) for one in score.per_frame[:2]] == [
        (0, 0, (), {1: None}),
        (1, 1, (1,), {1: 1}),
    ]
