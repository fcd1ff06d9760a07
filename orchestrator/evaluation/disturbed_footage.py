"""Sequences with accidents of real footage: lost pictures, new light, things drawn over the picture.

The accidents happen in the middle of a sequence, or last from there on. Frames that show nothing of the
scene, and pixels that are drawn over, are not judged.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.evaluation.disturbed_sequences import ChangedSequence
from orchestrator.evaluation.overlap import NOT_JUDGED
from orchestrator.evaluation.sequences import Sequence, SequenceChange

__all__ = ["FOOTAGE"]

#: Frames in which a ramp of the exposure reaches its end.
_RAMP_FRAMES = 20


class _LostFrame(ChangedSequence):
    """The frame in the middle is replaced by what becomes of it and the one before."""

    def __init__(self, sequence: Sequence, lost: Callable[[Array, Array], Array]) -> None:
        super().__init__(sequence)
        self._lost = lost
        self._middle = len(sequence.stems) // 2

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        if index != self._middle or index == 0:
            return super().frame(index)
        return self._lost(super().frame(index - 1), super().frame(index))

    def has_truth(self, index: int) -> bool:
        """Whether frame ``index`` has truth."""
        return index != self._middle and super().has_truth(index)

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8, or None."""
        return None if index == self._middle else super().truth(index)


class _NewLight(ChangedSequence):
    """From the middle on, each channel is multiplied, fully after ``ramp`` frames."""

    def __init__(self, sequence: Sequence, gain: tuple[float, float, float], ramp: int = 1) -> None:
        super().__init__(sequence)
        self._gain, self._ramp = np.array(gain), ramp
        self._middle = len(sequence.stems) // 2

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        share = min(max((index - self._middle + 1) / self._ramp, 0.0), 1.0)
        lit = super().frame(index) * (1.0 + share * (self._gain - 1.0))
        return np.clip(lit, 0, 255).astype(np.uint8)


class _DrawnOver(ChangedSequence):
    """Something is drawn over each picture: ``draw(picture, covered, index)`` draws into both."""

    def __init__(self, sequence: Sequence, draw: Callable[[Array, Array, int], None]) -> None:
        super().__init__(sequence)
        self._draw = draw

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        return self._drawn(super().frame(index), index)[0]

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8, or None."""
        truth = super().truth(index)
        if truth is None:
            return None
        covered = self._drawn(np.zeros((*truth.shape, 3), np.uint8), index)[1]
        return np.where(covered, np.uint8(NOT_JUDGED), truth)

    def _drawn(self, picture: Array, index: int) -> tuple[Array, Array]:
        picture, covered = np.ascontiguousarray(picture).copy(), np.zeros(picture.shape[:2], np.uint8)
        self._draw(picture, covered, index)
        return picture, covered > 0


def _filled(before: Array, frame: Array, level: int) -> Array:
    return np.full_like(frame, level)


def _doubled(before: Array, frame: Array) -> Array:
    return before


def _torn(before: Array, frame: Array) -> Array:
    height, width = frame.shape[:2]
    torn = frame.copy()
    torn[height // 2 :] = np.roll(frame[height // 2 :], width // 4, axis=1)
    return torn


def _clock(picture: Array, covered: Array, index: int) -> None:
    height, width = covered.shape
    scale = height / 480
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.7 * scale
    texts = (
        (f"2024-05-13 12:34:{index // 25 % 60:02d}", (round(10 * scale), round(30 * scale))),
        ("CAM 03 PARKING", (width - round(240 * scale), height - round(15 * scale))),
    )
    for text, place in texts:
        for canvas, colour, stroke in (
            (picture, (0, 0, 0), 4),
            (picture, (255, 255, 255), 2),
            (covered, (255,), 4),
        ):
            thickness = max(1, round(stroke * scale))
            cv2.putText(canvas, text, place, font, size, colour, thickness, cv2.LINE_8)


def _logo(picture: Array, covered: Array, index: int) -> None:
    height, width = covered.shape
    scale = height / 480
    centre, radius = (width - round(60 * scale), round(50 * scale)), round(34 * scale)
    cv2.circle(picture, centre, radius, (30, 30, 200), -1)
    cv2.circle(picture, centre, radius // 2, (240, 240, 240), -1)
    cv2.circle(covered, centre, radius, (1,), -1)


def _bonnet(picture: Array, covered: Array, index: int) -> None:
    height, width = covered.shape
    shares = ((0, 1), (0, 0.93), (0.2, 0.85), (0.5, 0.82), (0.8, 0.85), (1, 0.93), (1, 1))
    corners = np.rint(np.array(shares) * (width, height)).astype(np.int32)
    cv2.fillPoly(covered, [corners], (1,))
    shade = np.linspace(40, 100, height)[:, None, None] + np.array([10.0, 5.0, 0.0])
    picture[covered > 0] = np.broadcast_to(shade, picture.shape)[covered > 0].astype(np.uint8)


def _bars(picture: Array, covered: Array, index: int) -> None:
    rows = round(0.12 * len(covered))
    for canvas, value in ((picture, 0), (covered, 1)):
        canvas[:rows] = value
        canvas[-rows:] = value


#: Accidents by the names of their rows.
FOOTAGE: dict[str, SequenceChange] = {
    "one black frame": partial(_LostFrame, lost=partial(_filled, level=0)),
    "one white frame": partial(_LostFrame, lost=partial(_filled, level=255)),
    "one doubled frame": partial(_LostFrame, lost=_doubled),
    "one torn frame": partial(_LostFrame, lost=_torn),
    "exposure × 1.9": partial(_NewLight, gain=(1.9, 1.9, 1.9)),
    "exposure × 0.5": partial(_NewLight, gain=(0.5, 0.5, 0.5)),
    "exposure × 1.9 in 20 frames": partial(_NewLight, gain=(1.9, 1.9, 1.9), ramp=_RAMP_FRAMES),
    "white balance": partial(_NewLight, gain=(0.8, 1.0, 1.2)),
    "a clock and a name": partial(_DrawnOver, draw=_clock),
    "a logo": partial(_DrawnOver, draw=_logo),
    "a bonnet": partial(_DrawnOver, draw=_bonnet),
    "black bars": partial(_DrawnOver, draw=_bars),
}
