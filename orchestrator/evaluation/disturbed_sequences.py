"""Sequences derived from other sequences: mirrored, cropped, with frames left out.

Pictures, truth and exact motion take the same change, so a disturbed sequence is scored like any other.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.sequences import Sequence

__all__ = ["ChangedSequence", "CroppedSequence", "MirroredSequence", "SelectedFrames", "every_second_frame"]


class ChangedSequence:
    """A derived sequence; subclasses map the frames and change the arrays."""

    def __init__(self, sequence: Sequence) -> None:
        self.name = sequence.name
        self.stems = sequence.stems
        self.remark = sequence.remark
        self._sequence = sequence

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        return self._changed(self._sequence.frame(self._original(index)))

    def has_truth(self, index: int) -> bool:
        """Whether frame ``index`` has truth."""
        return self._sequence.has_truth(self._original(index))

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8, or None."""
        truth = self._sequence.truth(self._original(index))
        return None if truth is None else self._changed(truth)

    def motion(self, index: int) -> Array | None:
        """Exact backward motion of frame ``index``, (H, W, 2) float32 px, or None."""
        motion = self._sequence.motion(self._original(index))
        return None if motion is None else self._changed(motion)

    def _original(self, index: int) -> int:
        return index

    def _changed(self, array: Array) -> Array:
        return array


class MirroredSequence(ChangedSequence):
    """The sequence mirrored left to right."""

    def motion(self, index: int) -> Array | None:
        """Exact backward motion of frame ``index``, (H, W, 2) float32 px, or None."""
        motion = super().motion(index)
        return None if motion is None else motion * np.array([-1, 1], np.float32)

    def _changed(self, array: Array) -> Array:
        return np.ascontiguousarray(array[:, ::-1])


class CroppedSequence(ChangedSequence):
    """The sequence without its first rows and columns.

    Parameters
    ----------
    sequence : Sequence
    pixels : int
        How many of each.
    """

    def __init__(self, sequence: Sequence, pixels: int) -> None:
        super().__init__(sequence)
        self._margin = pixels

    def _changed(self, array: Array) -> Array:
        return np.ascontiguousarray(array[self._margin :, self._margin :])


class SelectedFrames(ChangedSequence):
    """Every ``step``-th frame from frame ``first`` on, as a sequence of its own.

    Raises
    ------
    SourceError
        If no frame with truth is among them.
    """

    def __init__(self, sequence: Sequence, first: int = 0, step: int = 1) -> None:
        super().__init__(sequence)
        self.stems = sequence.stems[first::step]
        self._originals = range(first, len(sequence.stems), step)
        self._step = step
        if not any(sequence.has_truth(index) for index in self._originals):
            raise SourceError(
                f"{sequence.name}: no frame with truth is left with frames {first}, {first + step}, … alone; "
                "leave this sequence out."
            )

    def motion(self, index: int) -> Array | None:
        """Return None where frames between are left out: places hidden meanwhile make their sum wrong."""
        return super().motion(index) if self._step == 1 else None

    def _original(self, index: int) -> int:
        return self._originals[index]


def every_second_frame(sequence: Sequence) -> SelectedFrames:
    """Select the even or the odd frames, whichever have more truth: some sequences have it for few frames."""
    kept = [sum(map(sequence.has_truth, range(first, len(sequence.stems), 2))) for first in (0, 1)]
    return SelectedFrames(sequence, first=int(kept[1] > kept[0]), step=2)
