"""Rerun: a recording for its viewer, with the pictures if their source can be read again.

It has the contents of the record: label maps, the boxes, areas and motions of the objects, the motion of the
camera. Internals (:mod:`orchestrator.export.rerun_internals`) are computed again on request.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import rerun
from rich.console import Console
from rich.progress import track

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import BACKGROUND, Array, LayerSummary
from mlbs_actors.record.edits import NO_EDITS
from mlbs_actors.record.recorded_stream import (
    RecordedFrame,
    description_of,
    recorded_stream,
    streams_of,
)
from orchestrator.export.replay import inspected, with_pictures
from orchestrator.export.rerun_internals import layer_rgb, layout, write_internals
from orchestrator.ignored import read_ignored
from orchestrator.pictures.privacy import is_private

__all__ = ["write_rerun"]

_JPEG_QUALITY = 85


def write_rerun(run: Path, out: Path, *, internals: bool = False) -> list[str]:
    """Write a recording with the timelines ``frame`` and ``time``, and these entities for each stream.

    =========================  ==============================================================
    ``NAME/image``             the picture, if it can be read again; of a private run blurred
    ``NAME/labels``            the label map, a class for each layer
    ``NAME/camera``            motion of the background, dx and dy
    ``NAME/layers/ID``         an object's box
    ``NAME/layers/ID/motion``  its velocity, an arrow from its centre
    ``NAME/layers/ID/area``    its number of pixels
    =========================  ==============================================================

    Parameters
    ----------
    run : Path
    out : Path
        The file.
    internals : bool
        Segment every stream again, with progress on standard error, and log the internals: see
        :func:`~orchestrator.export.rerun_internals.write_internals`.

    Returns
    -------
    list of str
        Sentences about internals that are missing or differ from the recorded label maps.
    """
    sources, private = streams_of(run), is_private(description_of(run))
    with rerun.RecordingStream("mlbs-actors") as recording:
        recording.save(out)
        recording.set_log_time_enabled(False)  # the time of the export is irrelevant
        for name, source in sources.items():
            pairs = with_pictures(run / name, source, private=private)
            _StreamLog(recording, name).write(pairs)
        return _add_internals(recording, run, sources) if internals else []


def _add_internals(recording: rerun.RecordingStream, run: Path, sources: Mapping[str, str]) -> list[str]:
    asked = description_of(run)
    ignored = read_ignored(list(asked["ignore"] or ()))
    for fault in ignored.faults:
        raise ConfigError(fault)
    layers: dict[str, tuple[int, ...]] = {}
    remarks: list[str] = []
    for name, source in sources.items():
        # Labelling it again gives the ids of the record, not those of corrections.
        recorded, own = list(recorded_stream(run / name, NO_EDITS)), asked | asked["settings"].get(name, {})
        config = Config.model_validate(own["config"])
        frames = inspected(
            recorded, source, config, own["max_frames"], own["max_side"], ignored.mask_of(name)
        )
        shown = track(frames, name, len(recorded), console=Console(stderr=True))
        written = write_internals(recording, name, shown)
        layers[name] = written.layers
        remarks += written.remarks(name, len(recorded))
    recording.send_blueprint(layout(layers))
    return remarks


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
            for gone in sorted(shown - present):  # else the viewer keeps showing its last position
                self._log(rerun.Clear(recursive=True), "layers", str(gone))
            shown = present
            seen |= present
        # Without a class of its own the background would be painted over the picture in the viewer's colour.
        classes = [rerun.AnnotationInfo(id=BACKGROUND, label="background", color=(0, 0, 0, 0))]
        classes += [
            rerun.AnnotationInfo(id=layer, label=str(layer), color=layer_rgb(layer)) for layer in sorted(seen)
        ]
        self._log(rerun.AnnotationContext(classes), static=True)

    def _write_object(self, one: LayerSummary) -> None:
        region, place = one.region, ("layers", str(one.layer))
        corner, size = (region.x, region.y), (region.width, region.height)
        self._log(rerun.Boxes2D(mins=[corner], sizes=[size], class_ids=[one.layer]), *place)
        arrow = rerun.Arrows2D(origins=[one.centroid], vectors=[one.velocity], class_ids=[one.layer])
        self._log(arrow, *place, "motion")
        self._log(rerun.Scalars(one.area), *place, "area")

    def _log(self, entity: Any, *place: str, static: bool = False) -> None:
        self._recording.log(rerun.new_entity_path([self._name, *place]), entity, static=static)


def _jpeg(picture: Array) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()
