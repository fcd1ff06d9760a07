"""The record of one stream, which survives a kill.

Frames are collected in groups: the first :data:`FIRST_COMMIT` frames, so that there is soon something to see,
then up to every multiple of :data:`GROUP_FRAMES`. A group is committed in this order: its files are written
under temporary names, synced together, renamed, and then one line in ``commits.jsonl`` makes them count. The
ends of groups depend on the frame's index alone, so the parts do not depend on the speed of the stream.

An existing record is continued: rows that it already has are skipped when they come again.

A live source cannot be read again. So its rows are committed only when a snapshot that covers them is
complete: there is always a snapshot after exactly the committed rows. Its record may be in segments.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq

from mlbs_actors.actors.stream.protocol import Opening, Snapshot
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import Array, LayerAppearance, Segmentation
from mlbs_actors.record.commits import oldest_frame, permanent, read_commits
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.record_tables import newest_part, part_path
from mlbs_actors.source import GapStatus, SourceFrame
from orchestrator.events.stream_events import StreamEvents
from orchestrator.events.zones import EventRules
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.sinks.background import background_plate
from orchestrator.sinks.cutouts import cutouts
from orchestrator.sinks.label_image import encode_label_image, encode_picture
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.live_picture import LivePicture
from orchestrator.sinks.object_files import ObjectFiles
from orchestrator.sinks.overlay import overlay_path
from orchestrator.sinks.shown_pictures import ShownPictures
from orchestrator.sinks.still import Still
from orchestrator.sources.address import SourceAddress
from orchestrator.storage.commit_log import CommitLog
from orchestrator.storage.durable_files import (
    UnwritableError,
    publish,
    remove_temporary,
    temporary_path,
)
from orchestrator.storage.picture_folders import PictureFolders
from orchestrator.storage.segments import Segments
from orchestrator.storage.snapshot_folder import SNAPSHOTS, SnapshotFolder
from orchestrator.storage.tables import stages_of, write_frames, write_layers

__all__ = ["FIRST_COMMIT", "GROUP_FRAMES", "StreamRecord", "ends_group", "has_snapshot", "recorded_frames"]

#: Frames of the first commit.
FIRST_COMMIT = 8

#: A commit ends before each multiple of this.
GROUP_FRAMES = 32


def ends_group(index: int) -> bool:
    """Whether a group is committed after this frame of the source; each group has a background plate."""
    return index + 1 == FIRST_COMMIT or (index + 1) % GROUP_FRAMES == 0


class StreamRecord:
    """Writes the record of one stream.

    Parameters
    ----------
    folder : Path
        The stream's folder; created if missing.
    name : str
        The stream's name.
    save : frozenset of str
        Any of ``"masks"``, ``"parquet"``, ``"overlay"``, ``"background"``, ``"cutouts"``.
    live_picture : LivePicture, optional
        Receives every frame, for the monitor.
    live : bool
        Whether the source is a camera, whose uncommitted rows cannot be read again after the end of the run.
    source : SourceAddress, optional
        Of the stream, whose sound the overlay gets.
    rules : EventRules, optional
        What its events depend on.
    segment_seconds : int, optional
        Length of the segments of a live source's record; by default it has none.
    drawing : Drawing
        What its pictures show.
    clock : callable
        Seconds since 1970, at which a live source's rows come.

    Attributes
    ----------
    opening : Opening

    Raises
    ------
    SinkError
        Here and from every method, if the record cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        save: frozenset[str],
        live_picture: LivePicture | None = None,
        *,
        live: bool = False,
        source: SourceAddress | None = None,
        rules: EventRules | None = None,
        segment_seconds: int | None = None,
        drawing: Drawing = DEFAULT_DRAWING,
        clock: Callable[[], float] | None = None,
    ) -> None:
        rules = rules or EventRules()
        self._clock = clock or time.time
        self._folder = folder
        self._name = name
        self._save = save
        self._shown = ShownPictures(rules.zones, drawing, live_picture, Still(folder) if live else None)
        self._live = live
        self._rows: list[FrameRow] = []
        self._provisional = False
        self._begins_with = 0  # first frame of which the lists know
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._log = CommitLog(folder)
            with self._log.exclusive():
                self._segments = None if segment_seconds is None else Segments(folder, segment_seconds)
                self._pictures = self._segments or PictureFolders(folder, save)
                self._snapshots = SnapshotFolder(folder / SNAPSHOTS, self._log.generation, self._log.rows)
                self._stages = self._clear_up()
                self._events = StreamEvents(folder, name, rules, self._log.rows, drawing)
            tables = "parquet" in save
            self._objects = ObjectFiles(folder, name) if tables else None
        except OSError as error:
            raise self._unwritable(error) from None
        before = self._snapshots.newest
        if live and self._log.rows != (0 if before is None else before.rows):
            raise SinkError(
                f"The stream in {folder} cannot continue: its last snapshot is missing or damaged, and a "
                "camera cannot be read twice. What was committed is kept; begin anew in another folder."
            )
        self.opening = Opening(self._snapshots.place, before)
        self._label_maps = 0 if before is None else before.label_maps
        self._committed = self._label_maps
        if "overlay" in save and self._segments is None:
            self._shown.begin_overlay(overlay_path(folder, self._log.rows), source)

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Write one result; return the number of label maps committed."""
        self._label_maps += 1
        if frame.index < self._log.rows:
            self._committed = self._label_maps
            return self._committed
        try:
            scene = self._events.place(segmentation, frame)
            result = ResultRow.of(segmentation, frame.pixel_aspect, scene)
            row = FrameRow(frame.index, frame.pts, segmentation.status, result, frame.name)
            self._tell(row, frame.image, frame.taken)
            if "masks" in self._save:
                self._put(frame, "masks", f"{frame.name}.png", encode_label_image(segmentation.labels))
            if "cutouts" in self._save and frame.image is not None:
                self._pictures.begin(frame.name)
                for layer, picture in cutouts(segmentation, frame.image):
                    self._put(frame, "cutouts", f"{frame.name}-{layer}.png", encode_picture(picture))
            if "background" in self._save and background is not None and frame.image is not None:
                plate = background_plate(background, frame.image, segmentation.labels)
                self._put(frame, "background", f"{frame.name}.png", encode_picture(plate))
            self._add(row)
        except OSError as error:
            raise self._unwritable(error) from None
        if self._segments is not None and "overlay" in self._save and not self._shown.has_overlay:
            self._shown.begin_overlay(overlay_path(self._segments.folder, frame.index), growing=True)
        if frame.image is not None:
            taken = self._events.file.taken_at(frame.pts)
            self._shown.show(LabelledPicture.of(segmentation, frame, frame.image, taken, scene))
        return self._committed

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame that has no label map; return the number of label maps committed."""
        try:
            if index >= self._log.rows:
                row = FrameRow(index, pts, status)
                self._tell(row)
                self._add(row)
        except OSError as error:
            raise self._unwritable(error) from None
        return self._committed

    def silent(self) -> None:
        """Note that a camera sends nothing at present."""
        self._events.file.silent()
        try:
            self._write_events()
        except OSError as error:
            raise self._unwritable(error) from None

    def configure(self, settings: object) -> None:
        """Follow other rules of events, which are an :class:`EventRules`, from the next row on."""
        assert isinstance(settings, EventRules)
        self._shown.follow(settings.zones)
        try:
            with self._log.exclusive():
                self._events.configure(settings, self._log.rows)
            self._write_events()
        except OSError as error:
            raise self._unwritable(error) from None

    def keep(self, snapshot: Snapshot) -> bool:
        """Register a snapshot to go back to; False if its files are not complete yet.

        Rows of a live source are committed with their snapshot, so for that they must be written, too.
        """
        if self._live and self._log.rows + len(self._rows) < snapshot.rows:
            return False
        try:
            kept = self._snapshots.keep(snapshot)
            if kept and self._live:
                self._commit(snapshot.rows)
        except OSError as error:
            raise self._unwritable(error) from None
        return kept

    def provisional(self) -> None:
        """Commit all rows so far; the label maps from here on will be replaced by a run that resumes."""
        try:
            self._commit()
        except OSError as error:
            raise self._unwritable(error) from None
        self._provisional = True

    def close(self, *, whole: bool) -> int:
        """Commit the rest and finish the pictures; return the number of label maps committed."""
        try:
            if not self._live or self._provisional or whole:
                self._commit()
            with self._log.exclusive():
                if self._segments is not None:
                    self._segments.merge_all(self._log)
                if whole:
                    self._events.file.finish(self._log.rows)
                else:
                    self._events.file.show_counts()
                if self._objects is not None:
                    self._objects.write(complete=whole)
            self._pictures.discard()
            self._events.discard()
        except OSError as error:
            raise self._unwritable(error) from None
        self._shown.close()
        if whole:
            self._snapshots.forget_all()
        return self._committed

    def _taken_at(self, pts: float) -> float:
        """Return when a live source's frame of a time was taken, seconds since 1970."""
        taken = self._events.file.taken_at(pts)
        return self._clock() if taken is None else taken

    def _put(self, frame: SourceFrame, part: str, name: str, content: bytes) -> None:
        """Write a picture that counts once its frame is committed."""
        time = 0.0 if not self._live else self._taken_at(frame.pts)
        self._pictures.put(frame.index, part, name, content, time)

    def _clear_up(self) -> tuple[str, ...] | None:
        """Remove unfinished work of a killed run; return the stages that have columns in the tables."""
        remove_temporary(self._folder)
        for table in self._folder.glob("*-*.parquet"):
            if int(table.stem.partition("-")[2]) >= self._log.rows:
                table.unlink()
        newest = newest_part(self._folder, "frames")
        return None if newest is None else stages_of(pq.read_schema(newest))

    def _add(self, row: FrameRow) -> None:
        self._rows.append(row)
        if not self._live and ends_group(row.frame):
            self._commit()

    def _tell(self, row: FrameRow, image: Array | None = None, taken: float | None = None) -> None:
        """Write the events that the next row, taken then, makes certain, with their pictures."""
        self._events.add(row, image, taken)
        if self._segments is not None and self._segments.name is None:
            with self._log.exclusive():
                self._segments.advance(self._taken_at(row.pts))
        self._write_events()

    def _write_events(self) -> None:
        if self._events.file.unwritten:
            with self._log.exclusive():
                self._events.file.write()

    def _commit(self, before: float = math.inf) -> None:
        """Commit the rows before a number, by default all."""
        rows = [row for row in self._rows if row.frame < before]
        if not rows:
            return
        last = rows[-1].frame
        with self._log.exclusive():
            if self._segments is not None:
                self._advance(rows[-1])
            files = self._pictures.drafts(before)
            if "parquet" in self._save:
                files += self._write_tables(rows, self._pictures.folder)
            files += self._events.drafts(last + 1, provisional=self._provisional)
            publish(files)
            archived = self._pictures.append(before)
            self._log.add(
                last,
                self._snapshots.name_after(last + 1),
                provisional=self._provisional,
                segment=self._pictures.name,
                archived=archived,
            )
            self._pictures.committed(before, archived)
            self._events.committed(last + 1)
            self._rows = self._rows[len(rows) :]
            self._committed = self._label_maps - sum(row.result is not None for row in self._rows)
            self._snapshots.forget_before(last + 1)
            if self._objects is not None:
                self._objects.add(rows, provisional=self._provisional)
            if self._segments is not None:
                self._segments.merge(self._log)
                self._forget_deleted()

    def _advance(self, row: FrameRow) -> None:
        """Begin another segment if a commit with this last row is the first of one."""
        assert self._segments is not None
        if self._segments.advance(self._taken_at(row.pts)):
            self._shown.end_overlay()  # the next frame begins another

    def _forget_deleted(self) -> None:
        """Take out of the lists what is from before the oldest segment that is left."""
        first = oldest_frame(self._folder)
        if first > self._begins_with:
            self._begins_with = first
            self._events.forget_before(first)
            if self._objects is not None:
                self._objects.forget_before(first)

    def _write_tables(self, rows: list[FrameRow], folder: Path) -> list[Path]:
        if self._stages is None:
            results = [row.result for row in rows if row.result is not None]
            self._stages = tuple(sorted({stage for result in results for stage in result.stage_ms}))
        first = rows[0].frame
        layers, frames = part_path(folder, "layers", first), part_path(folder, "frames", first)
        write_layers(temporary_path(layers), self._name, rows)
        write_frames(temporary_path(frames), self._name, rows, self._stages)
        return [layers, frames]

    def _unwritable(self, error: OSError) -> UnwritableError:
        reason = error.strerror or type(error).__name__
        return UnwritableError(
            f"The record of {self._name!r} cannot be written to {self._folder}: {reason}. "
            "Check the folder and the free space."
        )


def recorded_frames(folder: Path) -> int:
    """Return the number of source frames in a stream's commit log, including those without a label map."""
    commits = read_commits(folder)
    return commits[-1].last + 1 if commits else 0


def has_snapshot(folder: Path) -> bool:
    """Whether there is the snapshot that the last permanent line of a stream's log names."""
    commits = permanent(read_commits(folder))
    newest = commits[-1].snapshot if commits else None
    return newest is not None and (folder / SNAPSHOTS / newest).exists()
