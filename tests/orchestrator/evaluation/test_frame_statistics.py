"""Mean, recall and decay of a measure, beside the rules of DAVIS and TrackEval written out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.evaluation.frame_statistics import frame_statistics

VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=200)


def slow_decay(values: list[float]) -> float:
    """Four bins whose ends are at 1 + quarter · (n − 1) / 4, rounded half up; ends belong to both sides."""
    ends = [1]
    for quarter in range(1, 5):
        exact = 4 + quarter * (len(values) - 1)  # × 4
        ends.append((exact + 2) // 4)
    bins = []
    for quarter in range(4):
        bins.append([values[place - 1] for place in range(ends[quarter], ends[quarter + 1] + 1)])
    return math.fsum(bins[0]) / len(bins[0]) - math.fsum(bins[3]) / len(bins[3])


def trackeval(values: list[float]) -> tuple[float, float, float]:
    """What TrackEval's documentation of J&F says, with its 8-bit places: right up to 256 frames."""
    measured = np.asarray(values)
    places = (np.round(np.linspace(1, len(values), 5) + 1e-10) - 1).astype(np.uint8)
    bins = [measured[places[i] : places[i + 1] + 1] for i in range(4)]
    recall = np.nanmean(measured > 0.5 + np.finfo(float).eps)
    return float(np.nanmean(measured)), float(recall), float(np.nanmean(bins[0]) - np.nanmean(bins[3]))


@given(VALUES)
def test_decay_is_what_is_lost_from_the_first_of_four_bins_to_the_last(values: list[float]) -> None:
    assert frame_statistics(values).decay == pytest.approx(slow_decay(values), abs=1e-12)


@given(st.lists(st.sampled_from([0.0, 0.3, 0.5, 0.7, 1.0]), min_size=1, max_size=200))
def test_all_three_are_those_of_trackeval(values: list[float]) -> None:
    assert frame_statistics(values) == pytest.approx(trackeval(values), abs=1e-12)


def test_recall_counts_frames_above_a_half() -> None:
    assert frame_statistics([0.5, 0.51, 1, 0]).recall == 0.5


def test_a_sequence_of_more_than_256_frames_has_its_own_last_quarter() -> None:
    assert frame_statistics([1.0] * 200 + [0.0] * 200).decay == 1


def test_without_frames_nothing_is_known() -> None:
    assert all(map(math.isnan, frame_statistics([])))
