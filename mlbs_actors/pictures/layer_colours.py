"""A colour for every layer id: light, and far from those of the other ids.

The label maps keep the palette of the data sets, whose first colours are dark. Here an id's colour is the
same in every picture of every run, and light enough to be seen on dark video; drawings on light video get a
dark rim.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

__all__ = ["COLOURS", "layer_colour"]

#: Colours before they repeat.
COLOURS = 64

_LIGHTNESS = (62.0, 92.0)  # of CIE L*a*b*
_LEAST_CHROMA = 38.0  # less looks grey
_LEVELS = 9  # of red, green and blue among which the colours are chosen


@cache
def _distinct_colours() -> list[tuple[int, int, int]]:
    """Choose light colours one by one, each as far from those before it as it can be (L*a*b* distance).

    Returns
    -------
    list of COLOURS (blue, green, red), in [0, 255]
    """
    levels = np.linspace(0, 255, _LEVELS).round().astype(np.uint8)
    candidates = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(1, -1, 3)
    lab = cv2.cvtColor(candidates.astype(np.float32) / 255, cv2.COLOR_BGR2LAB)[0]
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    usable = (lab[:, 0] >= _LIGHTNESS[0]) & (lab[:, 0] <= _LIGHTNESS[1]) & (chroma >= _LEAST_CHROMA)
    candidates, lab = candidates[0, usable], lab[usable]
    chosen = [int(np.hypot(lab[:, 1], lab[:, 2]).argmax())]
    distance = np.full(len(lab), np.inf)
    while len(chosen) < COLOURS:
        distance = np.minimum(distance, np.linalg.norm(lab - lab[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return [(blue, green, red) for blue, green, red in candidates[chosen].tolist()]


def layer_colour(layer: int) -> tuple[int, int, int]:
    """Return the colour of a layer id, BGR."""
    return _distinct_colours()[(layer - 1) % COLOURS]
