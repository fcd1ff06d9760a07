"""The score of a mask in a word, by what masks of such scores were worth on sequences with truth."""

from __future__ import annotations

__all__ = ["SCORE_WORDS", "score_word"]

#: From the highest to the lowest: the least score, the word, and the share of such masks that lay on no
#: object, of 1,870 masks of the sequences to which the score was fitted (docs/research.md).
SCORE_WORDS = (
    (0.7, "good", 0.01),
    (0.5, "fair", 0.17),
    (0.3, "doubtful", 0.62),
    (0.0, "mostly nothing", 0.87),
)


def score_word(score: float) -> str:
    """Return the word for a score, 0 to 1."""
    return next(word for least, word, _ in SCORE_WORDS if score >= least)
