"""The score of a mask: what intersection over union with its object is to be expected of it.

Not in the paper. A logistic regression of three values that are known anyway, fitted to the intersection over
union of 1,870 masks of 21 sequences with the truth object that each fits best, every sequence with the same
weight. Masks that are on no object of the truth count as 0, so the score says both whether there is an object
and how well it is outlined. ``docs/experiments`` has what was tried, and how well it predicts on sequences
that it was not fitted to.
"""

from __future__ import annotations

import math

__all__ = ["mask_score"]

#: Weight of the mean posterior of the mask.
_CONFIDENCE = 7.66
#: Weight of how certain the layer's own model is over its region.
_MODEL_CONFIDENCE = 2.95
#: Weight of the logarithm of the mask's share of the frame, up to ``_LARGE``.
_AREA = 1.32
#: Share of the frame from which size says nothing more.
_LARGE = 0.01
_OFFSET = 1.45


def mask_score(confidence: float, model_confidence: float, share: float) -> float:
    """Return the score of a layer's mask, in [0, 1].

    Parameters
    ----------
    confidence : float
        Mean posterior of the label over its pixels, in [0, 1].
    model_confidence : float
        :attr:`~mlbs_actors.messages.LayerPosterior.confidence` of the layer.
    share : float
        Share of the frame's pixels that it owns, in (0, 1].
    """
    log_odds = (
        _CONFIDENCE * confidence
        + _MODEL_CONFIDENCE * model_confidence
        + _AREA * math.log(min(share, _LARGE))
        + _OFFSET
    )
    return 1.0 / (1.0 + math.exp(-log_odds))
