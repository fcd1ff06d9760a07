"""How well the score of a mask says its quality: score beside intersection over union with the truth.

Every mask of a frame with truth counts, with the truth object that it fits best; one off all objects has 0,
also if it shows a mover that the truth leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import spearmanr

from orchestrator.evaluation.figures import format_table
from orchestrator.evaluation.scoring import ScoredMask

__all__ = ["reliability_table"]

_BINS = 10


def reliability_table(masks: Sequence[ScoredMask]) -> str:
    """Format a row per tenth of the score: how many masks, their mean score, and their mean quality.

    Below are the rank correlation of the two (Spearman) and the mean distance of score and quality over the
    rows, weighted by their masks (the expected calibration error).
    """
    score, iou, _ = np.asarray(masks, np.float64).reshape(-1, 3).T
    row_of = np.minimum((score * _BINS).astype(int), _BINS - 1)
    rows, error = [], 0.0
    for row in range(_BINS):
        own = row_of == row
        if not own.any():
            continue
        mean_score, mean_iou = float(score[own].mean()), float(iou[own].mean())
        error += float(own.mean()) * abs(mean_score - mean_iou)
        span = f"{row / _BINS:.1f} – {(row + 1) / _BINS:.1f}"
        rows.append([span, f"{own.sum()}", f"{mean_score:.2f}", f"{mean_iou:.2f}"])
    ranked = len(masks) > 1 and np.ptp(score) > 0 and np.ptp(iou) > 0
    rank = f"{spearmanr(score, iou).statistic:.2f}" if ranked else "-"
    table = format_table(["score", "masks", "mean score", "mean IoU"], rows)
    return f"{table}\nrank correlation {rank}, calibration error {error:.3f}"
