"""A stream's frames again, each with its picture and the objects that were chosen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.record.edits import Edits
from mlbs_actors.record.recorded_stream import RecordedFrame, recorded_stream
from mlbs_actors.wording import count_of
from orchestrator.export.replay import with_pictures
from orchestrator.make.choice import Choice, Chosen
from orchestrator.make.moments import Span, clock
from orchestrator.make.watching import Watch
from orchestrator.pictures.content import Drawing
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sources.address import SourceAddress, parse_address

__all__ = ["Footage", "Shot"]


@dataclass(frozen=True, slots=True)
class Shot:
    """A frame of the footage.

    Attributes
    ----------
    frame : RecordedFrame
        With the objects that were chosen.
    whole : RecordedFrame
        With all.
    picture : (H, W, 3) uint8
        BGR.
    """

    frame: RecordedFrame
    whole: RecordedFrame
    picture: Array

    def masks(self) -> tuple[Array, Array]:
        """Return where the chosen objects are, and where others are, each (H, W) bool."""
        chosen = self.frame.labels() != BACKGROUND
        return chosen, (self.whole.labels() != BACKGROUND) & ~chosen

    def drawn(self, drawing: Drawing, width: int | None = None) -> Array:
        """Draw the chosen objects over the picture, which may be shrunk to a width before, px."""
        regions = {one.layer: one.region for one in self.frame.objects}
        return LabelledPicture(
            image=self.picture,
            labels=self.frame.labels(),
            index=self.frame.index,
            pts=self.frame.pts,
            regions=regions,
            pixel_aspect=self.frame.pixel_aspect,
        ).drawn((), drawing, width)


@dataclass(slots=True)
class Footage:
    """The part of a stream that something is made of; it can be read more than once.

    Attributes
    ----------
    stream : Path
        Its folder.
    source : str
    private : bool
        Whether what moves is blurred in its pictures, and its sound is left out.
    edits : Edits
    span : Span
    chosen : Chosen
    count : int
        Recorded frames in the span.
    missing : int
        How many of these had no picture, as far as they were last read.
    watch : Watch
        Shows how far they are read; by default only on a terminal.
    """

    stream: Path
    source: str
    private: bool
    edits: Edits
    span: Span
    chosen: Chosen
    count: int
    missing: int = field(default=0, init=False)
    watch: Watch = field(default_factory=lambda: Watch(lambda _: None), init=False)

    @classmethod
    def of(
        cls, stream: Path, source: str, choice: Choice, span: Span, edits: Edits, *, private: bool
    ) -> Footage:
        """Choose the objects of a stream.

        Raises
        ------
        ConfigError
            If its source is a camera, or it has no such objects, or nothing in this span.
        """
        if parse_address(source, Path("/")).live:
            raise ConfigError(
                f"{stream.name!r} is a camera, whose pictures cannot be read again; only files can."
            )
        recorded = partial(recorded_stream, stream, edits)
        count, newest = 0, None
        for newest in recorded():
            count += span.holds(newest.index, newest.pts)
        if newest is None:
            raise ConfigError(f"The stream {stream.name!r} has no label maps.")
        if not count:
            raise ConfigError(
                f"There is nothing from --from to --to in {stream.name!r}, whose last frame is "
                f"{newest.index} at {clock(newest.pts)}."
            )
        return cls(stream, source, private, edits, span, Chosen.of(choice, recorded(), span), count)

    @property
    def name(self) -> str:
        """Of the stream."""
        return self.stream.name

    @property
    def sound(self) -> SourceAddress | None:
        """What its sound is copied from."""
        return None if self.private else parse_address(self.source, Path("/"))

    def whole(self) -> Iterator[RecordedFrame]:
        """Yield the frames of the span with all objects, without reading the source."""
        for frame in recorded_stream(self.stream, self.edits):
            if self.span.holds(frame.index, frame.pts):
                yield frame

    def recorded(self) -> Iterator[RecordedFrame]:
        """Yield the frames of the span with the chosen objects, without reading the source."""
        return map(self.chosen.of_frame, self.whole())

    def shots(self, doing: str | None) -> Iterator[Shot]:
        """Read the span again.

        Parameters
        ----------
        doing : str, optional
            What is shown beside the progress; None for no progress.

        Raises
        ------
        ConfigError
            After the last frame, if none had a picture.
        """
        missing = 0
        pairs = self._pairs() if doing is None else self.watch.shown(self._pairs(), doing, self.count)
        try:
            for whole, picture in pairs:
                if picture is None or picture.shape[:2] != (whole.height, whole.width):
                    missing += 1
                else:
                    yield Shot(self.chosen.of_frame(whole), whole, picture)
        finally:  # also if no more is asked for
            self.missing = missing
        if missing == self.count:
            raise ConfigError(
                f"{self.source}, the source of {self.name!r}, cannot be read again in the size recorded; put "
                "it back to where it was."
            )

    def remarks(self) -> list[str]:
        """Say what was missing."""
        if not self.missing:
            return []
        of_all = count_of(self.count, "frame")
        return [f"{self.name}: {self.missing} of {of_all} could not be read again and are left out."]

    def _pairs(self) -> Iterator[tuple[RecordedFrame, Array | None]]:
        for whole, picture in with_pictures(self.stream, self.source, private=self.private, edits=self.edits):
            if self.span.is_over(whole.index, whole.pts):
                return
            if self.span.holds(whole.index, whole.pts):
                yield whole, picture
