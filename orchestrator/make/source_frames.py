"""The frames from which a background is taken: which are held, and which of them serve a frame.

Held are frames spread over the whole clip, and, while it is filled, more of them around the frame at hand.
All are held at full size, their number is limited by :data:`HELD_BYTES`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.background_motion import Sketch

__all__ = [
    "BESIDE",
    "EDGE",
    "NEAR_STEP",
    "Source",
    "SpreadSources",
    "chosen_sources",
    "held_sources",
    "near_sources",
    "source_of",
]

#: Memory of the frames held, at most; but at least a dozen are.
HELD_BYTES = 384 * 2**20
#: Frames held, least and most.
HELD = (12, 200)
#: Every how many frames one near the frame at hand is held.
NEAR_STEP = 2
#: Of the picture's width: nearer to what covers it, a pixel counts only where nothing else is known.
EDGE = 1 / 320
#: What :attr:`Source.clear` is there, as a share of its greatest value.
BESIDE = np.float32(1 / 255)
#: Of the picture's width: how far from what covers it a pixel is above suspicion.
CLEAR = 1 / 16
#: Sources that serve a frame, at most.
CHOSEN = 12
#: Share of the doubt about a hole that a source must remove to be used.
LEAST_GAIN = 0.01


@dataclass(frozen=True, slots=True)
class Source:
    """A frame from which the background of others is taken.

    Attributes
    ----------
    index : int
        In the clip, from 0.
    picture : (H, W, 3) uint8
        BGR.
    clear : (H, W) uint8
        0 where covered, 1 beside that, up to 255 as far from that as :data:`CLEAR` says.
    sketch : Sketch
    """

    index: int
    picture: Array
    clear: Array
    sketch: Sketch


def source_of(index: int, frame: Array, covered: Array, sketch: Sketch) -> Source:
    """Prepare a frame as a source; ``covered`` (H, W) bool is where it does not show the background."""
    width = frame.shape[1]
    distance = np.minimum(cv2.distanceTransform(1 - covered.astype(np.uint8), cv2.DIST_L2, 3), width)
    beyond = distance - max(1.0, EDGE * width)
    clear = np.clip(beyond * np.float32(255 / (CLEAR * width)), 2, 255)
    clear[beyond <= 0] = 1
    clear[covered] = 0
    return Source(index, frame, clear.astype(np.uint8), sketch)


def held_sources(shape: tuple[int, int]) -> int:
    """Return how many sources of frames (H, W) are held, spread and near together."""
    least, most = HELD
    return max(least, min(most, HELD_BYTES // (9 * shape[0] * shape[1])))


class SpreadSources:
    """Keeps every n-th frame of a clip of unknown length, n as small as their number allows."""

    def __init__(self, number: int) -> None:
        self._number, self._step = number, 1
        self.kept: list[Source] = []

    def wants(self, index: int) -> bool:
        """Whether the frame of this index would be kept."""
        return index % self._step == 0

    def add(self, source: Source) -> None:
        """Keep a frame that is wanted."""
        self.kept.append(source)
        if len(self.kept) > self._number:
            self._step *= 2
            self.kept = [one for one in self.kept if one.index % self._step == 0]


def near_sources(sources: Iterable[Source], count: int, number: int) -> Iterator[Sequence[Source]]:
    """Yield for each of ``count`` frames up to ``number`` of the sources around it; they come in order."""
    reach = number // 2 * NEAR_STEP
    held = deque[Source]()
    coming = iter(sources)
    ahead = next(coming, None)
    for index in range(count):
        while ahead is not None and ahead.index <= index + reach:
            held.append(ahead)
            ahead = next(coming, None)
        while held and held[0].index < index - reach:
            held.popleft()
        yield tuple(held)


def chosen_sources(
    sources: Sequence[Source], places: Mapping[int, Array], nearness: Mapping[int, float], index: int
) -> list[Source]:
    """Choose the sources that serve a frame.

    One after the other, the one that removes most of the doubt about the hole's places, first where none was
    seen. Sources that moved little against the frame count for more: they are placed better.

    Parameters
    ----------
    sources : sequence of Source
    places : mapping of int to (n, 2) float32
        For the index of each source that can serve, and for the frame itself, where places in the hole lie in
        its sketch, px.
    index : int
        The frame's.

    Returns
    -------
    list of Source
        Best first.
    """
    candidates = [one for one in sources if one.index in places and one.index != index]
    if not candidates or not len(places[index]):
        return []
    worth = np.stack(
        [_worth(one, places[one.index], places[index], nearness[one.index]) for one in candidates]
    )
    doubt = np.ones(worth.shape[1])  # of each place: 1 unseen, the less the more and the clearer its views
    chosen: list[Source] = []
    while len(chosen) < CHOSEN:
        gains = (doubt * -np.expm1(-worth)).mean(axis=1)
        best = int(np.argmax(gains))
        if gains[best] < LEAST_GAIN:
            break
        chosen.append(candidates[best])
        doubt *= np.exp(-worth[best])
        worth[best] = 0.0
    return chosen


def _worth(source: Source, there: Array, here: Array, nearness: float) -> Array:
    """Return what a source shows of places (n, 2) of a frame so many frames away, 0 … 1 each."""
    (height, width), sketch = source.clear.shape, source.sketch.gray.shape
    moved = np.linalg.norm(there - here, axis=1) / sketch[1]
    scale: Array = np.array([width / sketch[1], height / sketch[0]])
    at = np.round((there + 0.5) * scale - 0.5).astype(int)
    inside = (at >= 0).all(axis=1) & (at < (width, height)).all(axis=1)
    clear = np.zeros(len(there), np.float32)
    clear[inside] = source.clear[at[inside, 1], at[inside, 0]] / np.float32(255)
    shown = np.where(clear > BESIDE, 0.3 + 0.7 * clear, np.where(clear > 0, 0.05, 0.0))
    worth: Array = shown * np.exp(-moved / 0.3) * np.sqrt(nearness)
    return worth
