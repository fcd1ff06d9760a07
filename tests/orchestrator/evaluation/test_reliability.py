"""The score of a mask beside its quality: pairs by frame and label, and what the table says of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from record_fakes import HEIGHT, WIDTH, frame, segmentation

from orchestrator.evaluation.command import main
from orchestrator.evaluation.reliability import reliability_table
from orchestrator.evaluation.scoring import ScoredMask, scored_masks
from orchestrator.evaluation.sequence_scorer import SequenceScorer
from orchestrator.sinks.record import StreamRecord


def test_each_mask_has_the_quality_of_the_object_that_it_fits_best() -> None:
    scorer = SequenceScorer()
    truth = np.array([[1, 1, 1, 2, 0, 0]], np.uint8)
    scorer.add(0, np.array([[7, 7, 0, 7, 0, 8]]), truth)  # 7: 2 of 4 px of object 1, 1 of 3 of object 2
    scorer.add(1, np.array([[7, 7, 7, 0, 0, 0]]), None)
    scorer.add(2, np.array([[7, 7, 7, 0, 0, 0]]), truth)
    scores = {0: {7: 0.4, 8: 0.1}, 1: {7: 0.9}, 2: {7: 0.8}}
    masks = scored_masks(scorer.score(), scores)
    assert [(one.score, one.iou) for one in masks] == [(0.4, 0.5), (0.1, 0.0), (0.8, 1.0)]
    # An object's score is the mean of those of its masks, in frames without truth as well.
    assert [one.object_score for one in masks] == pytest.approx([0.7, 0.1, 0.7])


def test_the_table_has_a_row_a_tenth_and_the_distance_of_score_and_quality() -> None:
    pairs = [(0.95, 0.9), (0.93, 0.8), (1.0, 1.0), (0.2, 0.3)]
    masks = [ScoredMask(score, iou, object_score=0.5) for score, iou in pairs]
    heading, *rows, last = reliability_table(masks).splitlines()
    assert [row.split()[3:] for row in rows] == [["1", "0.20", "0.30"], ["3", "0.96", "0.90"]]
    assert last == "rank correlation 1.00, calibration error 0.070"
    assert heading.split()[1] == "masks"


def test_the_scores_of_a_run_come_from_its_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "gt").mkdir()
    record = StreamRecord(tmp_path / "out/yard", "yard", frozenset({"masks", "parquet"}))
    for index in range(4):
        record.write(segmentation(index), frame(index))
        truth = np.zeros((HEIGHT, WIDTH), np.uint8)
        truth[5:15, index : index + 16] = 1  # twice as wide as the mask
        cv2.imwrite(f"{tmp_path}/gt/img{index:03d}.png", truth)
    record.close(whole=True)
    assert main(["--run", f"{tmp_path}/out", "--truth", f"yard={tmp_path}/gt", "--reliability"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if line.startswith("0.5 –")).split()[3:] == ["4", "0.50", "0.50"]
