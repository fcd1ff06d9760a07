"""Rerun: a recording that its viewer plays, with the pictures if their source can be read again.

It holds what the record holds: label maps, the boxes, areas and motions of the objects, the motion of the
camera. The trajectories of single points, the motion fields and the posteriors are in no record.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import rerun

from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from orchestrator.export.recorded_stream import RecordedFrame, RecordedObject, recorded_stream, streams_of
from orchestrator.sinks.layer_colours import layer_colour
from orchestrator.sources.address import SourceKind, parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["write_rerun"]

_JPEG_QUALITY = 85


def write_rerun(run: Path, out: Path) -> None:
    """Write a recording with the timelines ``frame`` and ``time``, and these entities for each stream.

    =========================  =======================================
    ``NAME/image``             the picture, if it can be read again
    ``NAME/labels``            the label map, a class for each layer
    ``NAME/camera``            motion of the background, dx and dy
    ``NAME/layers/ID``         an object's box
    ``NAME/layers/ID/motion``  its velocity, an arrow from its centre
    ``NAME/layers/ID/area``    its number of pixels
    =========================  =======================================

    Parameters
    ----------
    run : Path
    out : Path
        The file.
    """
    with rerun.RecordingStream("mlbs-actors") as recording:
        recording.save(out)
        recording.set_log_time_enabled(False)  # the time of the export tells nothing
        for name, source in streams_of(run).items():
            _StreamLog(recording, name).write(_with_pictures(recorded_stream(run / name), source))


class _StreamLog:
    """One stream's part of the recording."""

    def __init__(self, recording: rerun.RecordingStream, name: str) -> None:
        self._recording = recording
        self._name = name

    def write(self, frames: Iterable[tuple[RecordedFrame, Array | None]]) -> None:
        """Log all frames, with or without their pictures."""
        seen: set[int] = set()
        shown: set[int] = set()
        for frame, picture in frames:
            self._recording.set_time("frame", sequence=frame.index)
            self._recording.set_time("time", duration=frame.pts)
            if picture is not None:
                self._log(rerun.EncodedImage(contents=_jpeg(picture), media_type="image/jpeg"), "image")
            self._log(rerun.SegmentationImage(frame.labels()), "labels")
            self._log(rerun.Scalars(frame.camera_motion), "camera")
            for one in frame.objects:
                self._write_object(one)
            present = {one.layer for one in frame.objects}
            for gone in sorted(shown - present):  # else the viewer goes on showing where it was last
                self._log(rerun.Clear(recursive=True), "layers", str(gone))
            shown = present
            seen |= present
        classes = [
            rerun.AnnotationInfo(id=layer, label=str(layer), color=_rgb(layer)) for layer in sorted(seen)
        ]
        self._log(rerun.AnnotationContext(classes), static=True)

    def _write_object(self, one: RecordedObject) -> None:
        region, place = one.region, ("layers", str(one.layer))
        corner, size = (region.x, region.y), (region.width, region.height)
        self._log(rerun.Boxes2D(mins=[corner], sizes=[size], class_ids=[one.layer]), *place)
        arrow = rerun.Arrows2D(origins=[one.centroid], vectors=[one.velocity], class_ids=[one.layer])
        self._log(arrow, *place, "motion")
        self._log(rerun.Scalars(one.area), *place, "area")

    def _log(self, entity: Any, *place: str, static: bool = False) -> None:
        self._recording.log(rerun.new_entity_path([self._name, *place]), entity, static=static)


def _with_pictures(
    frames: Iterable[RecordedFrame], source: str
) -> Iterator[tuple[RecordedFrame, Array | None]]:
    """Pair the frames with their pictures: None for all that cannot be read (again)."""
    pictures = _pictures(source)
    newest = next(pictures, None)
    for frame in frames:
        while newest is not None and newest.index < frame.index:
            newest = next(pictures, None)
        yield frame, newest.image if newest is not None and newest.index == frame.index else None


def _pictures(source: str) -> Iterator[SourceFrame]:
    """Read a source again; nothing comes from a camera, nor from what is not there any more."""
    try:
        address = parse_address(source, Path("/"))
        if address.kind not in (SourceKind.PATH, SourceKind.SYNTHETIC):
            return
        with closing(open_reader(address)) as reader:
            while isinstance(frame := reader.read(), SourceFrame):
                yield frame
    except (ConfigError, SourceError):
        return


def _jpeg(picture: Array) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()


def _rgb(layer: int) -> tuple[int, int, int]:
    blue, green, red = layer_colour(layer)
    return red, green, blue
