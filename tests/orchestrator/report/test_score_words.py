"""Scores in words, by the bounds that the docs have from masks with truth."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest

from orchestrator.rows.score_words import SCORE_WORDS, score_word

RESEARCH = Path(__file__).parents[3] / "docs/research.md"


@pytest.mark.parametrize(
    ("score", "word"),
    [(0.0, "mostly nothing"), (0.3, "doubtful"), (0.63, "fair"), (0.72, "good"), (1.0, "good")],
)
def test_a_score_has_a_word(score: float, word: str) -> None:
    assert score_word(score) == word


def test_the_shares_are_those_of_the_measured_table() -> None:
    text = RESEARCH.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (0\.\d) – [\d.]+ \| (\d+) \| [\d.]+ \| [\d.]+ \| (\d+) % \|$", text, re.MULTILINE)
    measured = [(float(least), int(masks), int(share)) for least, masks, share in rows]
    assert len(measured) == 10
    for (least, _, share), above in zip(SCORE_WORDS, (1.1, *(one[0] for one in SCORE_WORDS)), strict=False):
        inside = [(masks, part) for begin, masks, part in measured if least <= begin < above]
        mean = sum(masks * part for masks, part in inside) / sum(masks for masks, _ in inside)
        assert mean / 100 == pytest.approx(share, abs=0.006)
    assert all(one[0] > other[0] and one[2] < other[2] for one, other in pairwise(SCORE_WORDS))
