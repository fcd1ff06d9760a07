"""Pictures of a run without frames beside the truth: its own sources, read again."""

from __future__ import annotations

from collections.abc import Iterator

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame
from orchestrator.evaluation.disturbed_sequences import ChangedSequence
from orchestrator.evaluation.sequences import Sequence
from orchestrator.export.replay import replayed

__all__ = ["RunSequence"]


class RunSequence(ChangedSequence):
    """A sequence whose missing pictures come from the source of a run.

    Parameters
    ----------
    sequence : Sequence
    source : str
        Its address.
    """

    def __init__(self, sequence: Sequence, source: str) -> None:
        super().__init__(sequence)
        self._source = source
        self._pictures: Iterator[SourceFrame] = iter(())

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        try:
            return super().frame(index)
        except SourceError:
            # Frames are mostly asked for in order; otherwise the source is read from its start.
            for pictures in (self._pictures, replayed(self._source)):
                self._pictures = pictures
                for picture in pictures:
                    if picture.name == self.stems[index] and picture.image is not None:
                        return picture.image
        raise SourceError(f"{self._source} no longer gives the picture {self.stems[index]}.")
