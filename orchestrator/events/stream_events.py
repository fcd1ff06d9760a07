"""All that a stream's record holds of its events: the lines, the pictures, and the views of the scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.scene_place import ScenePlace
from mlbs_actors.source import SourceFrame
from orchestrator.events.event_file import EventFile
from orchestrator.events.file_names import forget_clips_before
from orchestrator.events.outlines import outlines
from orchestrator.events.pictures import EventPictures, Pictured
from orchestrator.events.scene import VIEWS, SceneTracker
from orchestrator.events.zones import EventRules
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.storage.durable_files import remove_temporary, temporary_path

__all__ = ["StreamEvents"]


class StreamEvents:
    """The events of one stream; made and written to only while other processes are kept out.

    Parameters
    ----------
    folder : Path
        Of the stream.
    stream : str
        Its name.
    rules : EventRules
    rows : int
        Rows of the record that count.
    drawing : Drawing
        What its pictures show.

    Attributes
    ----------
    file : EventFile
        The lines.
    """

    def __init__(
        self, folder: Path, stream: str, rules: EventRules, rows: int, drawing: Drawing = DEFAULT_DRAWING
    ) -> None:
        self._folder = folder
        self._drawing = drawing
        self.file = EventFile(folder, stream, rules, rows)
        self._pictures: EventPictures | None = None
        self._views = folder / VIEWS
        self._new_views: list[tuple[int, Path]] = []  # not committed yet, with their frames
        self._scene: SceneTracker | None = None
        self._prepare(rules, rows)

    def configure(self, rules: EventRules, rows: int) -> None:
        """Follow other rules after the rows so far, of which ``rows`` count; OSError as the disk says."""
        self.file.configure(rules)
        self._prepare(rules, rows)

    def _prepare(self, rules: EventRules, rows: int) -> None:
        self._zones = rules.zones
        if self._pictures is None and rules.zones:
            self._pictures = EventPictures(self._folder, ids=self._drawing.ids)
        if self._scene is None and rules.of_scene:
            self._views.mkdir(exist_ok=True)
            remove_temporary(self._views)
            state = self.file.state
            place = None if state.shown is None else state.shown.scene
            self._scene = SceneTracker(self._views, rows, place, state.pts)

    def place(self, segmentation: Segmentation, frame: SourceFrame) -> ScenePlace | None:
        """Follow the scene into the next frame; return where it is there, None if unknown or not needed."""
        if self._scene is None or frame.image is None:
            return None
        if (view := self._scene.after(frame.pts, segmentation, frame.image)) is not None:
            path = self._views / f"{frame.index:08d}.npz"
            temporary_path(path).write_bytes(view.content())
            self._new_views.append((frame.index, path))
        return self._scene.place

    def add(self, row: FrameRow, image: Array | None, taken: float | None) -> None:
        """Add the next row of the record, and write the pictures that its lines name.

        Parameters
        ----------
        row : FrameRow
        image : (H, W, 3) uint8, optional
            The frame's picture, if it has one.
        taken : float, optional
            When a camera took it, seconds since 1970.
        """
        pictured = self.file.add(row, taken)
        if pictured and self._pictures is not None and row.result is not None and image is not None:
            time = self._drawing.time(row.pts, self.file.taken_at(row.pts))
            self._pictures.write(image, row.frame, time, self._pictured(row.result, pictured))

    def _pictured(self, result: ResultRow, zones_of: Mapping[int, Collection[str]]) -> list[Pictured]:
        """Return the objects of which pictures are taken, with the outlines of their zones."""
        zones = self._zones if self._drawing.zones else ()
        return [
            Pictured(
                layer,
                outlines(
                    (zone for zone in zones if zone.name in zones_of[layer.layer]), result.shape, result.scene
                ),
            )
            for layer in result.layers
            if layer.layer in zones_of
        ]

    def drafts(self, rows: int, *, provisional: bool) -> list[Path]:
        """Return the files to publish before so many rows are committed, provisionally or for good."""
        views = [path for frame, path in self._new_views if frame < rows]
        return views if provisional else [*views, *self.file.drafts(rows)]

    def committed(self, rows: int) -> None:
        """Note that so many rows count now."""
        self._new_views = [(frame, path) for frame, path in self._new_views if frame >= rows]

    def forget_before(self, frame: int) -> None:
        """Delete the oldest lines, pictures and clips, as far as they are of frames before a number."""
        self.file.forget_before(frame)
        forget_clips_before(self._folder, frame)
        if self._pictures is not None:
            self._pictures.forget_before(frame)

    def discard(self) -> None:
        """Delete what was written of rows that are not committed."""
        for _, path in self._new_views:
            temporary_path(path).unlink(missing_ok=True)
