"""The pictures of a stream that are there to be looked at: overlay video, live picture and still.

Nothing goes on from them, and an error of theirs ends none of the stream.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.events.zones import Zone
from orchestrator.pictures.content import Drawing
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.live_picture import LivePicture
from orchestrator.sinks.overlay import OverlayVideo
from orchestrator.sinks.still import Still
from orchestrator.sources.address import SourceAddress

__all__ = ["ShownPictures"]


class ShownPictures:
    """Shows every frame wherever it is to be seen.

    Parameters
    ----------
    zones : sequence of Zone
        Drawn over overlays.
    drawing : Drawing
        What is drawn there beside them.
    live_picture : LivePicture, optional
    still : Still, optional
    """

    def __init__(
        self,
        zones: Sequence[Zone],
        drawing: Drawing,
        live_picture: LivePicture | None = None,
        still: Still | None = None,
    ) -> None:
        self._zones = zones
        self._drawing = drawing
        self._live_picture = live_picture
        self._still = still
        self._overlay: OverlayVideo | None = None

    @property
    def has_overlay(self) -> bool:
        """Whether an overlay is being written."""
        return self._overlay is not None

    def begin_overlay(self, path: Path, sound: SourceAddress | None = None, *, growing: bool = False) -> None:
        """Write an overlay from the next frame on; see :class:`OverlayVideo`."""
        self._overlay = OverlayVideo(path, sound, self._zones, self._drawing, growing=growing)

    def end_overlay(self) -> None:
        """Finish the overlay, if there is one."""
        if self._overlay is not None:
            self._overlay.close()
            self._overlay = None

    def follow(self, zones: Sequence[Zone]) -> None:
        """Draw other zones from the next frame on."""
        self._zones = zones
        for shown in (self._live_picture, self._overlay):
            if shown is not None:
                shown.zones = zones

    def show(self, picture: LabelledPicture) -> None:
        """Show the next frame."""
        if self._overlay is not None:
            self._overlay.add(picture)
        if self._live_picture is not None:
            self._live_picture.show(picture)
        if self._still is not None:
            self._still.show(picture.image)

    def close(self) -> None:
        """Finish the overlay, and show the last frame; may be called twice."""
        self.end_overlay()
        if self._live_picture is not None:
            self._live_picture.close()
