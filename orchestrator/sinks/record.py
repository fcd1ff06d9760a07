"""The record of one stream: what survives a kill.

Frames are collected in groups: the first :data:`FIRST_COMMIT` frames, so that there is something to look at
soon, then up to every multiple of :data:`GROUP_FRAMES`. A group is committed in this order: its files are
written under temporary names, synced together, renamed, and then one line in ``commits.jsonl`` says that
they count. Where a group ends follows from the frame's index alone, so the parts do not depend on how fast
the stream ran.
"""

from __future__ import annotations

import json
from pathlib import Path

from mlbs_actors.actors.stream_protocol import GapStatus, SourceFrame
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import LayerAppearance, Segmentation
from orchestrator.durable_files import append_line, publish, temporary_path
from orchestrator.sinks.background import background_plate
from orchestrator.sinks.cutouts import cutouts
from orchestrator.sinks.label_image import encode_label_image, encode_picture
from orchestrator.sinks.live_picture import LivePicture
from orchestrator.sinks.overlay import OverlayVideo
from orchestrator.sinks.record_tables import COMMIT_LOG, committed_groups
from orchestrator.sinks.tables import FrameRow, ResultRow, write_frames, write_layers

__all__ = ["FIRST_COMMIT", "GROUP_FRAMES", "StreamRecord", "ends_group", "recorded_frames"]

#: Frames of the first commit.
FIRST_COMMIT = 8

#: A commit ends before each multiple of this.
GROUP_FRAMES = 32


#: Parts that are folders of pictures.
_FOLDERS = frozenset({"masks", "background", "cutouts"})


def ends_group(index: int) -> bool:
    """Whether a group is committed after this frame of the source; a background plate belongs to each."""
    return index + 1 == FIRST_COMMIT or (index + 1) % GROUP_FRAMES == 0


class StreamRecord:
    """Writes the record of one stream.

    Parameters
    ----------
    folder : Path
        The stream's folder; made here, and refused if it exists.
    name : str
        The stream's name.
    save : frozenset of str
        Which of ``"masks"``, ``"parquet"``, ``"overlay"``, ``"background"``, ``"cutouts"`` to write.
    live : LivePicture, optional
        Shown every frame, for the monitor.

    Raises
    ------
    SinkError
        Here and from every method, if the record cannot be written.
    """

    def __init__(
        self, folder: Path, name: str, save: frozenset[str], live: LivePicture | None = None
    ) -> None:
        self._folder = folder
        self._name = name
        self._save = save
        self._live = live
        self._rows: list[FrameRow] = []
        self._unpublished: list[Path] = []
        self._committed = 0
        self._stages: tuple[str, ...] | None = None
        self._overlay = OverlayVideo(folder / "overlay.mp4") if "overlay" in save else None
        try:
            folder.mkdir(parents=True)
            for part in _FOLDERS & save:
                (folder / part).mkdir()
        except OSError as error:
            raise self._unwritable(error) from None

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Take one result; return how many label maps are committed."""
        try:
            if "masks" in self._save:
                self._put(f"masks/{frame.name}.png", encode_label_image(segmentation.labels))
            if "cutouts" in self._save and frame.image is not None:
                for layer, picture in cutouts(segmentation, frame.image):
                    self._put(f"cutouts/{frame.name}-{layer}.png", encode_picture(picture))
            if "background" in self._save and background is not None and frame.image is not None:
                plate = background_plate(background, frame.image, segmentation.labels)
                self._put(f"background/{frame.name}.png", encode_picture(plate))
            self._add(FrameRow(frame.index, frame.pts, "ok", ResultRow.of(segmentation), frame.name))
        except OSError as error:
            raise self._unwritable(error) from None
        if self._overlay is not None and frame.image is not None:
            self._overlay.add(frame.image, segmentation.labels, frame.index, frame.pts)
        if self._live is not None and frame.image is not None:
            self._live.show(frame.image, segmentation.labels, frame.index)
        return self._committed

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame that has no label map; return how many label maps are committed."""
        try:
            self._add(FrameRow(index, pts, status))
        except OSError as error:
            raise self._unwritable(error) from None
        return self._committed

    def close(self) -> int:
        """Commit what is left and finish the overlay; return how many label maps are committed."""
        try:
            self._commit()
        except OSError as error:
            raise self._unwritable(error) from None
        if self._overlay is not None:
            self._overlay.close()
        return self._committed

    def _put(self, name: str, content: bytes) -> None:
        """Write a file that counts from the next commit on."""
        path = self._folder / name
        temporary_path(path).write_bytes(content)
        self._unpublished.append(path)

    def _add(self, row: FrameRow) -> None:
        self._rows.append(row)
        if ends_group(row.frame):
            self._commit()

    def _commit(self) -> None:
        if not self._rows:
            return
        rows, files = self._rows, list(self._unpublished)
        first, last = rows[0].frame, rows[-1].frame
        if "parquet" in self._save:
            files += self._write_tables(rows, first)
        publish(files)
        line = {"generation": 0, "first": first, "last": last, "snapshot": None}
        append_line(self._folder / COMMIT_LOG, json.dumps(line))
        self._committed += sum(row.result is not None for row in rows)
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
    return sum(group["last"] - group["first"] + 1 for group in committed_groups(folder))
