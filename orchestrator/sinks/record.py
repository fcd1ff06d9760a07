"""The record of one stream: what survives a kill.

Frames are collected in groups, which end after every :data:`GROUP_FRAMES` frames of the source. A group is
committed in this order: its files are written under temporary names, synced together, renamed, and then one
line in ``commits.jsonl`` says that they count. The groups do not depend on how fast the stream ran.

A record that exists is gone on with: rows that it holds already are passed over when they come again.
"""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

from mlbs_actors.actors.stream_protocol import GapStatus, Opening, Snapshot, SourceFrame
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import Segmentation
from orchestrator.durable_files import publish, remove_temporary, temporary_path
from orchestrator.sinks.commit_log import CommitLog, read_commits
from orchestrator.sinks.label_image import encode_label_image
from orchestrator.sinks.overlay import OverlayVideo
from orchestrator.sinks.snapshot_folder import SNAPSHOTS, SnapshotFolder
from orchestrator.sinks.tables import FrameRow, ResultRow, stages_of, write_frames, write_layers

__all__ = ["GROUP_FRAMES", "StreamRecord", "recorded_frames"]

#: Rows of one commit.
GROUP_FRAMES = 32


class StreamRecord:
    """Writes the record of one stream.

    Parameters
    ----------
    folder : Path
        The stream's folder; made here if it is not there.
    name : str
        The stream's name.
    save : frozenset of str
        Which of ``"masks"``, ``"parquet"``, ``"overlay"`` to write.

    Attributes
    ----------
    opening : Opening

    Raises
    ------
    SinkError
        Here and from every method, if the record cannot be written.
    """

    def __init__(self, folder: Path, name: str, save: frozenset[str]) -> None:
        self._folder = folder
        self._name = name
        self._save = save
        self._rows: list[FrameRow] = []
        self._unpublished: list[Path] = []
        self._provisional = False
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if "masks" in save:
                (folder / "masks").mkdir(exist_ok=True)
            self._log = CommitLog(folder)
            with self._log.turn():
                self._snapshots = SnapshotFolder(folder / SNAPSHOTS, self._log.generation, self._log.rows)
                self._stages = self._clear_up()
        except OSError as error:
            raise self._unwritable(error) from None
        self.opening = Opening(self._snapshots.place, self._snapshots.newest)
        before = self._snapshots.newest
        self._label_maps = 0 if before is None else before.label_maps
        self._committed = self._label_maps
        name = f"overlay-{self._log.rows:08d}.mp4" if self._log.rows else "overlay.mp4"
        self._overlay = OverlayVideo(folder / name) if "overlay" in save else None

    def write(self, segmentation: Segmentation, frame: SourceFrame) -> int:
        """Take one result; return how many label maps are committed."""
        self._label_maps += 1
        if frame.index < self._log.rows:
            self._committed = self._label_maps
            return self._committed
        try:
            if "masks" in self._save:
                path = self._folder / "masks" / f"{frame.name}.png"
                temporary_path(path).write_bytes(encode_label_image(segmentation.labels))
                self._unpublished.append(path)
            self._add(FrameRow(frame.index, frame.pts, "ok", ResultRow.of(segmentation)))
        except OSError as error:
            raise self._unwritable(error) from None
        if self._overlay is not None and frame.image is not None:
            self._overlay.add(frame.image, segmentation.labels, frame.pts)
        return self._committed

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame that has no label map; return how many label maps are committed."""
        try:
            if index >= self._log.rows:
                self._add(FrameRow(index, pts, status))
        except OSError as error:
            raise self._unwritable(error) from None
        return self._committed

    def keep(self, snapshot: Snapshot) -> bool:
        """Note a snapshot that may be gone back to; False if its files are not all there yet."""
        try:
            return self._snapshots.keep(snapshot)
        except OSError as error:
            raise self._unwritable(error) from None

    def provisional(self) -> None:
        """Commit what is there; the label maps from here on are made anew by a run that resumes."""
        try:
            self._commit()
        except OSError as error:
            raise self._unwritable(error) from None
        self._provisional = True

    def close(self, *, whole: bool) -> int:
        """Commit what is left and finish the overlay; return how many label maps are committed."""
        try:
            self._commit()
        except OSError as error:
            raise self._unwritable(error) from None
        if self._overlay is not None:
            self._overlay.close()
        if whole:
            self._snapshots.forget_all()
        return self._committed

    def _clear_up(self) -> tuple[str, ...] | None:
        """Remove what a killed run left half done; return the stages that the tables have columns for."""
        remove_temporary(self._folder)
        remove_temporary(self._folder / "masks")
        stages = None
        for table in sorted(self._folder.glob("*-*.parquet")):
            kind, _, first = table.stem.partition("-")
            if int(first) >= self._log.rows:
                table.unlink()
            elif kind == "frames":
                stages = stages_of(pq.read_schema(table))
        return stages

    def _add(self, row: FrameRow) -> None:
        self._rows.append(row)
        if (row.frame + 1) % GROUP_FRAMES == 0:
            self._commit()

    def _commit(self) -> None:
        if not self._rows:
            return
        rows, files = self._rows, list(self._unpublished)
        last = rows[-1].frame
        if "parquet" in self._save:
            files += self._write_tables(rows, rows[0].frame)
        with self._log.turn():
            publish(files)
            self._log.add(last, self._snapshots.name_after(last + 1), provisional=self._provisional)
            self._snapshots.forget_before(last + 1)
        self._committed = self._label_maps
        self._rows, self._unpublished = [], []

    def _write_tables(self, rows: list[FrameRow], first: int) -> list[Path]:
        if self._stages is None:
            results = [row.result for row in rows if row.result is not None]
            self._stages = tuple(sorted({stage for result in results for stage in result.stage_ms}))
        layers = self._folder / f"layers-{first:08d}.parquet"
        frames = self._folder / f"frames-{first:08d}.parquet"
        write_layers(temporary_path(layers), self._name, rows)
        write_frames(temporary_path(frames), self._name, rows, self._stages)
        return [layers, frames]

    def _unwritable(self, error: OSError) -> SinkError:
        reason = error.strerror or type(error).__name__
        return SinkError(
            f"The record of {self._name!r} cannot be written to {self._folder}: {reason}. "
            "Check the folder and the free space, then run again into a new folder."
        )


def recorded_frames(folder: Path) -> int:
    """Number of the source's frames that a stream's commit log holds, those without a label map included."""
    commits = read_commits(folder)
    return commits[-1].last + 1 if commits else 0
