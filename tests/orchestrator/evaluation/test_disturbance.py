"""``scripts/evaluate --disturb``: how much accidents of parameters and input cost."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence

from mlbs_actors.config import Config, load_config
from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from orchestrator.evaluation import scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.disturbance import (
    DISTURBANCES,
    UNDISTURBED,
    Disturbance,
    disturbance_table,
    disturbance_variants,
    worst_run,
)
from orchestrator.evaluation.disturbed_footage import FOOTAGE
from orchestrator.evaluation.disturbed_sequences import (
    CroppedSequence,
    MirroredSequence,
    SelectedFrames,
    every_second_frame,
)
from orchestrator.evaluation.scoring import SequenceResult
from orchestrator.evaluation.sequence_scorer import SequenceScorer
from orchestrator.evaluation.sequences import SceneSequence, Sequence
from orchestrator.evaluation.variants import Variant, VariantResults


class NumberedSequence:
    """Frames of 6×8 px whose every pixel tells its frame, row and column; so does the truth, where it is."""

    def __init__(self, frames: int, with_truth: Collection[int] | None = None) -> None:
        self.name = "numbered"
        self.remark = None
        self.stems = tuple(f"{index:05d}" for index in range(1, frames + 1))
        self.with_truth = range(frames) if with_truth is None else with_truth

    def frame(self, index: int) -> Array:
        rows, columns = np.indices((6, 8))
        return np.stack([np.full_like(rows, index), rows, columns], axis=2).astype(np.uint8)

    def has_truth(self, index: int) -> bool:
        return index in self.with_truth

    def truth(self, index: int) -> Array | None:
        return _truth_of(self.frame(index)) if self.has_truth(index) else None

    def motion(self, index: int) -> Array | None:
        return self.frame(index)[:, :, 1:].astype(np.float32)


def _truth_of(frame: Array) -> Array:
    """The truth that belongs to a frame of a numbered sequence, whatever was done to both."""
    return frame @ np.array([48, 8, 1], np.uint8)


def shown_frames(sequence: Sequence) -> list[int]:
    """The original index of each frame."""
    return [int(sequence.frame(index)[0, 0, 0]) for index in range(len(sequence.stems))]


@pytest.mark.parametrize(
    "disturbance",
    [each for each in DISTURBANCES if each.change is not None and each.name not in FOOTAGE],
    ids=lambda each: each.name,
)
def test_frames_and_truth_take_the_same_change(disturbance: Disturbance) -> None:
    assert disturbance.change is not None
    original = NumberedSequence(5, with_truth=(0, 3, 4))
    sequence = disturbance.change(original)
    assert sequence.name == original.name
    for index, stem in enumerate(sequence.stems):
        frame, truth = sequence.frame(index), sequence.truth(index)
        shown = int(frame[0, 0, 0])
        assert stem == original.stems[shown]
        assert sequence.has_truth(index) == original.has_truth(shown) == (truth is not None)
        assert truth is None or np.array_equal(truth, _truth_of(frame))


class _GreySequence(NumberedSequence):
    """Grey pictures, lighter from frame to frame, whose lower half is an object."""

    def frame(self, index: int) -> Array:
        return np.full((96, 128, 3), 60 + 10 * index, np.uint8)

    def truth(self, index: int) -> Array | None:
        return np.repeat(np.array([[0] * 128, [1] * 128], np.uint8), 48, axis=0)


@pytest.mark.parametrize(
    ("name", "levels"),
    [
        ("one black frame", [0]),
        ("one white frame", [255]),
        ("one doubled frame", [70]),
        ("one torn frame", [80]),
    ],
)
def test_a_lost_frame_in_the_middle_is_not_judged(name: str, levels: list[int]) -> None:
    sequence, original = FOOTAGE[name](_GreySequence(5)), _GreySequence(5)
    assert np.unique(sequence.frame(2)).tolist() == levels
    assert [sequence.has_truth(index) for index in range(5)] == [True, True, False, True, True]
    assert sequence.truth(2) is None
    for index in (0, 1, 3, 4):
        np.testing.assert_array_equal(sequence.frame(index), original.frame(index))


@pytest.mark.parametrize(
    ("name", "colour"),
    [("exposure × 1.9", [152] * 3), ("exposure × 0.5", [40] * 3), ("white balance", [64, 80, 96])],
)
def test_new_light_is_that_of_all_frames_from_the_middle_on(name: str, colour: list[int]) -> None:
    sequence = FOOTAGE[name](_GreySequence(5))
    assert sequence.frame(2)[0, 0].tolist() == colour
    np.testing.assert_array_equal(sequence.frame(1), _GreySequence(5).frame(1))


@pytest.mark.parametrize("name", ["a clock and a name", "a logo", "a bonnet", "black bars"])
def test_what_is_drawn_over_is_not_judged_and_all_else_as_it_was(name: str) -> None:
    sequence, original = FOOTAGE[name](_GreySequence(5)), _GreySequence(5)
    truth, plain = sequence.truth(1), original.truth(1)
    assert truth is not None
    assert plain is not None
    drawn = (sequence.frame(1) != original.frame(1)).any(axis=2)
    covered = truth == 255
    assert drawn.any()
    assert covered[drawn].all()
    assert covered.mean() < 0.3
    np.testing.assert_array_equal(truth[~covered], plain[~covered])


def test_a_mirrored_sequence_moves_the_other_way() -> None:
    sequence = MirroredSequence(NumberedSequence(2))
    assert sequence.frame(1)[2, 0].tolist() == [1, 2, 7]
    motion = sequence.motion(1)
    assert motion is not None
    assert motion[2, 0].tolist() == [-2, 7]


def test_a_cropped_sequence_lacks_the_first_rows_and_columns() -> None:
    sequence = CroppedSequence(NumberedSequence(2), pixels=3)
    assert sequence.frame(1).shape == (3, 5, 3)
    assert sequence.frame(1)[0, 0].tolist() == [1, 3, 3]
    motion = sequence.motion(1)
    assert motion is not None
    assert motion[0, 0].tolist() == [3, 3]


def test_frames_left_out_are_left_out_of_everything() -> None:
    sequence = SelectedFrames(NumberedSequence(6), first=3)
    assert shown_frames(sequence) == [3, 4, 5]
    assert sequence.motion(1) is not None
    with pytest.raises(IndexError):
        sequence.frame(3)


def test_every_second_frame_is_every_second_one_and_its_motion_is_not_known() -> None:
    sequence = every_second_frame(NumberedSequence(7))
    assert shown_frames(sequence) == [0, 2, 4, 6]
    assert sequence.motion(1) is None


def test_every_second_frame_keeps_those_that_have_more_truth() -> None:
    sequence = every_second_frame(NumberedSequence(30, with_truth=(0, 9, 19, 29)))
    assert shown_frames(sequence)[:3] == [1, 3, 5]
    assert sum(map(sequence.has_truth, range(len(sequence.stems)))) == 3


def test_a_sequence_that_loses_all_its_truth_is_refused() -> None:
    with pytest.raises(SourceError, match="no frame with truth is left"):
        SelectedFrames(NumberedSequence(6, with_truth=(0, 1)), first=3)


def test_a_scene_disturbed_is_scored_like_any_other() -> None:
    sequence = MirroredSequence(SceneSequence("x", scene("crossing", frames=8, width=96, height=72)))
    truths = [(index, sequence.truth(index)) for index in range(8)]
    result = scoring.score_sequence(sequence, [(i, truth) for i, truth in truths if truth is not None])
    assert result.score is not None
    assert result.score.all_frames.object_f == 1


def test_fourteen_runs_are_disturbed_and_the_first_row_is_not() -> None:
    rows = disturbance_variants([])
    assert len(rows) == 1 + len(DISTURBANCES) == 27
    assert rows[0] == Variant(UNDISTURBED)
    assert len({row.name for row in rows}) == len(rows)
    assert all(row.overrides or row.change for row in rows[1:])


def test_every_disturbed_parameter_exists_and_is_scaled_from_its_default() -> None:
    default = Config().model_dump()
    for row, disturbance in zip(disturbance_variants([])[1:], DISTURBANCES, strict=True):
        disturbed = load_config(None, row.overrides).model_dump()
        for section, group in default.items():
            for key, value in group.items():
                scaled = f"{section}.{key}" in disturbance.parameters
                expected = disturbance.factor * value if scaled else value
                if isinstance(value, int):
                    expected = round(expected)
                assert disturbed[section][key] == (pytest.approx(expected) if scaled else expected)


def test_parameters_of_the_user_hold_in_every_row_and_are_what_is_scaled() -> None:
    rows = disturbance_variants(["affinity.radius_px=100", "layers.lookahead=2"])
    configs = {row.name: load_config(None, row.overrides) for row in rows}
    assert {config.layers.lookahead for config in configs.values()} == {2}
    assert configs[UNDISTURBED].affinity.radius_px == 100
    assert configs["trajectories × 0.8"].affinity.radius_px == pytest.approx(80)


def test_whole_numbers_stay_whole_when_they_are_scaled() -> None:
    _, row = disturbance_variants([], [Disturbance("x", ("affinity.cut_side_tracks",), 0.8)])
    assert load_config(None, row.overrides).affinity.cut_side_tracks == 10  # of 12


def test_every_change_reaches_other_processes() -> None:
    for disturbance in DISTURBANCES:
        change = pickle.loads(pickle.dumps(disturbance.change))
        if change is not None:
            assert change(NumberedSequence(5)).stems


def scored(found: int) -> SequenceResult:
    """A result with recall ``found`` of 10 and precision 1."""
    labels, truth = np.zeros((2, 10), np.uint16), np.zeros((2, 10), np.uint8)
    truth[0], labels[0, :found] = 1, 1
    scorer = SequenceScorer()
    scorer.add(0, labels, truth)
    return SequenceResult("clip", scorer.score())


def run(name: str, *results: SequenceResult) -> VariantResults:
    return VariantResults(Variant(name), results)


def test_the_worst_run_has_the_lowest_mean_and_the_first_of_equals_counts() -> None:
    runs = [run("a", scored(9), scored(9)), run("b", scored(10), scored(4)), run("c", scored(4), scored(10))]
    worst = worst_run(runs, "two_label_f")
    assert worst is not None
    assert worst.variant.name == "b"


def test_a_run_that_lost_a_sequence_is_the_worst() -> None:
    runs = [run("a", scored(1), scored(1)), run("b", SequenceResult("clip", error="lost"), scored(10))]
    worst = worst_run(runs, "two_label_f")
    assert worst is not None
    assert worst.variant.name == "b"
    assert math.isnan(worst.mean("two_label_f"))
    assert "worst two_label_f: b, failed (undisturbed 100)" in disturbance_table(
        [run(UNDISTURBED, scored(10), scored(10)), *runs]
    )


def test_a_figure_that_no_run_knows_has_no_worst_run() -> None:
    scorer = SequenceScorer()
    scorer.add(0, np.zeros((2, 2), np.uint16), np.zeros((2, 2), np.uint8))  # no object: object_f is unknown
    nothing = SequenceResult("clip", scorer.score())
    assert worst_run([run("a", nothing)], "object_f") is None
    assert "worst object_f" not in disturbance_table([run(UNDISTURBED, nothing), run("a", nothing)])


def test_the_table_names_the_worst_of_the_disturbed_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bright_sequence(tmp_path / "data" / "clip")
    wide = Config().affinity.radius_px
    monkeypatch.setattr(
        scoring,
        "MultilayerSubtractor",
        lambda config, flow, tracks: BrightSubtractor(blind=config.affinity.radius_px > wide),
    )
    figures = tmp_path / "figures.json"
    command = ["--disturb", "--data", f"{tmp_path}/data", "--jobs", "1", "--json", str(figures)]
    assert main(command) == 0
    heading, *lines = capsys.readouterr().out.splitlines()
    assert heading.split() == ["run", "two_label_f", "object_f", "clip"]
    table, ends = lines[:27], lines[-2:]
    assert table[0].split() == [UNDISTURBED, "100", "100", "100"]
    blind = [line.rsplit(maxsplit=3)[0].strip() for line in table if not line.endswith("100")]
    assert [name for name in blind if name not in FOOTAGE] == ["trajectories × 1.2"]
    assert ends == [
        f"worst {figure}: trajectories × 1.2, 0 (undisturbed 100)" for figure in ("two_label_f", "object_f")
    ]
    record = json.loads(figures.read_text())
    assert record["worst"] == dict.fromkeys(("two_label_f", "object_f"), "trajectories × 1.2")
    assert len(record["rows"]) == 27


def test_a_sequence_too_short_to_be_disturbed_is_told_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bright_sequence(tmp_path / "data" / "clip", frames=3)
    monkeypatch.setattr(scoring, "MultilayerSubtractor", None)
    with pytest.raises(SystemExit) as ended:
        main(["--disturb", "--data", f"{tmp_path}/data", "--jobs", "1"])
    assert ended.value.code == 2
    assert "clip: no frame with truth is left" in capsys.readouterr().err
