"""Plots: figures over time, and precision over recall by the score of objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.evaluation import plots, scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.precision_recall import precision_recall
from orchestrator.evaluation.scoring import ScoredMask, SequenceResult
from orchestrator.evaluation.sequence_scorer import SequenceScorer
from orchestrator.evaluation.variants import Variant, VariantResults

MASKS = st.lists(st.tuples(st.sampled_from([0.1, 0.4, 0.8]), st.sampled_from([0.0, 0.5, 0.9])), min_size=1)


def result_with(masks: list[tuple[float, float]]) -> SequenceResult:
    """As many objects as masks are right, and two lost ones."""
    scorer = SequenceScorer()
    right = sum(iou > 0.5 for _, iou in masks)
    scorer.add(0, np.zeros((1, right + 3), np.int32), np.arange(right + 3, dtype=np.uint8)[None])
    scored = tuple(ScoredMask(0.5, iou, object_score) for object_score, iou in masks)
    return SequenceResult("a", scorer.score(), masks=scored)


@given(MASKS)
def test_precision_and_recall_are_those_of_the_masks_kept_at_each_score(
    masks: list[tuple[float, float]],
) -> None:
    curve = precision_recall([result_with(masks)])
    assert curve is not None
    expected = []
    for least in sorted({score for score, _ in masks}, reverse=True):
        kept = [iou > 0.5 for score, iou in masks if score >= least]
        objects = sum(iou > 0.5 for _, iou in masks) + 2
        expected.append((least, sum(kept) / len(kept), sum(kept) / objects))
    points = list(zip(curve.least_score, curve.precision, curve.recall, strict=True))
    assert points == [pytest.approx(point) for point in expected]
    area, reached = 0.0, 0.0
    for place, (_, _, recall) in enumerate(expected):
        area += (recall - reached) * max(precision for _, precision, _ in expected[place:])
        reached = recall
    assert curve.average_precision == pytest.approx(area)


def test_without_scores_there_is_no_curve() -> None:
    assert precision_recall([SequenceResult("a")]) is None


def test_plots_are_written_for_looking_and_for_papers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bright_sequence(tmp_path / "data/set/clip")
    monkeypatch.setattr(scoring, "MultilayerSubtractor", lambda config, flow, tracks: BrightSubtractor())
    arguments = ["--data", f"{tmp_path}/data", "--jobs", "1", "--plots"]
    assert main([*arguments, f"{tmp_path}/plots"]) == 0
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == [
        "set-clip-over-time.pdf",
        "set-clip-over-time.png",
    ]
    said = capsys.readouterr().out
    assert f"see {tmp_path}/plots/set-clip-over-time.png" in said
    assert "no precision over recall is drawn: it needs objects in the truth, and the scores" in said
    assert b"/Type3" not in (tmp_path / "plots/set-clip-over-time.pdf").read_bytes()
    picture = cv2.imread(f"{tmp_path}/plots/set-clip-over-time.png")
    assert picture is not None
    assert picture.std() > 5
    assert main([*arguments, f"{tmp_path}/again"]) == 0
    for path in (tmp_path / "plots").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_lines_differ_by_more_than_their_colours_and_begin_at_the_number_of_the_first_picture() -> None:
    scorer = SequenceScorer()
    for index in range(3):
        scorer.add(index, np.zeros((2, 2), np.int32), np.ones((2, 2), np.uint8))
    result = SequenceResult("a", scorer.score(), stems=("00005", "00006", "00007"))
    rows = [VariantResults(Variant(name), (result,)) for name in ("one", "two")]
    panel = plots._over_time("a", 0, rows).axes[0]
    one, two = panel.lines
    assert one.get_linestyle() != two.get_linestyle()
    assert np.asarray(one.get_xdata()).tolist() == [5, 6, 7]
    assert panel.get_xlim()[0] == 5
    unnumbered = [replace(row, results=(replace(result, stems=("a", "b", "c")),)) for row in rows]
    assert np.asarray(plots._over_time("a", 0, unnumbered).axes[0].lines[0].get_xdata()).tolist() == [0, 1, 2]


def test_plots_without_matplotlib_are_refused_before_anything_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("orchestrator.extra.find_spec", lambda name: None)
    with pytest.raises(SystemExit):
        main(["--sequences", "synthetic:nowhere", "--plots", str(tmp_path)])
    assert "--plots needs matplotlib; install it with scripts/setup bench" in capsys.readouterr().err
