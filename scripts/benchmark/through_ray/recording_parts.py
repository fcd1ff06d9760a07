"""Parts of a stream that note on the way what they are, and when what came.

Each writes to small files of the process it works in; otherwise they are the parts that they are made around.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mlbs_actors import Config
from mlbs_actors.actors.parts import CoordinatorPart, LayerPart, PartFactory, SegmenterPart
from mlbs_actors.actors.stream.protocol import GapStatus, Snapshot, SourceFrame, StreamSink
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    Segmentation,
)

__all__ = ["SPARE", "NotingParts", "NotingSink"]

#: What a layer process is as long as it has been no layer.
SPARE = "spare layer"

#: Among the stages of a label map on its way to the sink: when it was made.
_LABELLED = "labelled"


@dataclass(frozen=True)
class NotingParts:
    """Other parts, and a file for each layer process that says what it is; one for those that wait."""

    parts: PartFactory
    folder: Path
    waiting: Path

    def coordinator(self, config: Config) -> CoordinatorPart:
        """See :class:`PartFactory`."""
        self._wait_no_more()
        return self.parts.coordinator(config)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """See :class:`PartFactory`."""
        if self._own_note.exists():  # else the layer begins in the segmenter's process
            self._note("background layer" if kind == "background" else "object layer")
        return self.parts.layer(config, layer, kind)

    def segmenter(self, config: Config) -> SegmenterPart:
        """See :class:`PartFactory`."""
        self._wait_no_more()
        return _NotingSegmenter(self.parts.segmenter(config))

    def warm_layer(self) -> None:
        """See :class:`PartFactory`."""
        self.parts.warm_layer()
        self._note(SPARE)

    def warm_stream(self) -> None:
        """See :class:`PartFactory`."""
        self.parts.warm_stream()
        (self.waiting / str(os.getpid())).touch()

    def _wait_no_more(self) -> None:
        (self.waiting / str(os.getpid())).unlink(missing_ok=True)

    def _note(self, kind: str) -> None:
        self._own_note.write_text(kind, encoding="utf-8")

    @property
    def _own_note(self) -> Path:
        return self.folder / str(os.getpid())


class _NotingSegmenter:
    """Another segmenter, which notes in each label map when it was made."""

    def __init__(self, part: SegmenterPart) -> None:
        self._part = part

    @property
    def state(self) -> Any:
        """See :class:`SegmenterPart`."""
        return self._part.state

    @state.setter
    def state(self, state: Any) -> None:
        self._part.state = state

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        """See :class:`SegmenterPart`."""
        made = self._part.step(evidence, frame, posteriors)
        return replace(made, stage_ms={**made.stage_ms, _LABELLED: time.monotonic()})


class NotingSink:
    """Another sink, and a line for each label map that came to it."""

    def __init__(self, open_sink: Callable[[], StreamSink], notes: Path) -> None:
        self._sink = open_sink()
        self.opening = self._sink.opening
        self._notes = notes.open("w", encoding="ascii", buffering=1)

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """See :class:`StreamSink`."""
        objects = " ".join(str(layer.layer) for layer in segmentation.layers)
        stage_ms = dict(segmentation.stage_ms)
        labelled = stage_ms.pop(_LABELLED)
        self._notes.write(f"{time.monotonic()} {labelled} {frame.index} {objects}\n")
        return self._sink.write(replace(segmentation, stage_ms=stage_ms), frame, background)

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """See :class:`StreamSink`."""
        return self._sink.gap(index, pts, status)

    def keep(self, snapshot: Snapshot) -> bool:
        """See :class:`StreamSink`."""
        return self._sink.keep(snapshot)

    def provisional(self) -> None:
        """See :class:`StreamSink`."""
        self._sink.provisional()

    def close(self, *, whole: bool) -> int:
        """See :class:`StreamSink`."""
        self._notes.close()
        return self._sink.close(whole=whole)
