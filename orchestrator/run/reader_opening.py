"""How the reader of a stream is opened, so that two ways can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from mlbs_actors.source import FrameReader
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.opening import open_reader
from orchestrator.sources.packets import PacketStore
from orchestrator.working_size import ShrinkingReader

__all__ = ["ReaderOpening"]


@dataclass(frozen=True, slots=True)
class ReaderOpening:
    """Opens the reader of a stream, in the process that reads; equal ones give the same frames.

    Parameters
    ----------
    address : SourceAddress
    give_up_after : float, optional
        Time without a picture after which a camera is given up, s.
    max_side : int, optional
        See :class:`ShrinkingReader`.
    packets : PacketStore, optional
        Keeps what a camera sends.
    """

    address: SourceAddress
    give_up_after: float | None = None
    max_side: int | None = None
    packets: PacketStore | None = None

    def __call__(self) -> FrameReader:
        """Open it; raises SourceError if that is not possible."""
        open_source = partial(open_reader, self.address, self.give_up_after, self.packets)
        return open_source() if self.max_side is None else ShrinkingReader(open_source, self.max_side)
