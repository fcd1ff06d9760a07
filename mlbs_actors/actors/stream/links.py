"""The processes that a stream's coordinator works with, besides those of its layers."""

from __future__ import annotations

from dataclasses import dataclass

from mlbs_actors.actors.node.failures import POOL, SEGMENTER, SINK
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.processes import identity

__all__ = ["StreamLinks"]


@dataclass(frozen=True, slots=True)
class StreamLinks:
    """The actors a coordinator works with.

    Attributes
    ----------
    reader, segmenter : Handle
        The stream's own.
    pool, sink : Handle
        The node's.
    """

    reader: Handle
    segmenter: Handle
    pool: Handle
    sink: Handle

    def roles(self) -> dict[str, str]:
        """Return the parts by actor id, for messages; the reader's failures have messages of their own."""
        named = ((self.segmenter, SEGMENTER), (self.pool, POOL), (self.sink, SINK))
        return {identity(handle): role for handle, role in named}
