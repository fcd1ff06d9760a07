"""A record around another one: the base of those that hold rows back, hide parts of them, or hand them on."""

from __future__ import annotations

from collections.abc import Callable

from mlbs_actors.actors.stream.protocol import Opening, Snapshot, StreamSink
from mlbs_actors.messages import LayerAppearance, Segmentation
from mlbs_actors.source import GapStatus, SourceFrame

__all__ = ["OuterRecord"]


class OuterRecord:
    """Passes everything on to the record inside; a :class:`StreamSink`, whose methods are described there.

    Parameters
    ----------
    open_record : callable
        Opens the record inside.
    """

    def __init__(self, open_record: Callable[[], StreamSink]) -> None:
        self._record = open_record()

    @property
    def opening(self) -> Opening:
        """State of the record when it was opened."""
        return self._record.opening

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Write one result; return the number of label maps committed."""
        return self._record.write(segmentation, frame, background)

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame without a label map; return the number of label maps committed."""
        return self._record.gap(index, pts, status)

    def silent(self) -> None:
        """Note that a camera sends nothing at present."""
        self._flush()
        self._record.silent()

    def configure(self, settings: object) -> None:
        """Follow other settings from the next row on."""
        self._flush()
        self._record.configure(settings)

    def keep(self, snapshot: Snapshot) -> bool:
        """Register a snapshot to go back to; False if its files are not complete yet."""
        return self._record.keep(snapshot)

    def provisional(self) -> None:
        """Mark the label maps from here on as provisional."""
        self._flush()
        self._record.provisional()

    def close(self, *, whole: bool) -> int:
        """Commit the rest and close all files; return the number of label maps committed."""
        self._flush()
        return self._record.close(whole=whole)

    def _flush(self) -> None:
        """Pass on what is held back; called before the record inside hears of anything but rows."""
