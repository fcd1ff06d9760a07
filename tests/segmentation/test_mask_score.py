"""The score of a mask rises with what speaks for it, and stays in [0, 1]."""

from __future__ import annotations

import itertools

from mlbs_actors.segmentation.mask_score import mask_score


def test_more_certain_and_larger_masks_score_higher_until_size_says_no_more() -> None:
    assert mask_score(0.9, 0.5, 0.005) > mask_score(0.6, 0.5, 0.005)
    assert mask_score(0.8, 0.9, 0.005) > mask_score(0.8, 0.2, 0.005)
    assert mask_score(0.8, 0.5, 0.005) > mask_score(0.8, 0.5, 0.0005)
    assert mask_score(0.8, 0.5, 0.9) == mask_score(0.8, 0.5, 0.01)


def test_it_is_a_share_for_whatever_is_measured() -> None:
    for values in itertools.product((0.0, 1.0), (0.0, 1.0), (1e-7, 1.0)):
        assert 0 < mask_score(*values) < 1
