"""Parts of a stream that record the role of their process, and when label maps were made and arrived.

Each wraps another part and otherwise behaves like it; it writes to small files, one for each process.
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
from mlbs_actors.actors.stream.protocol import StreamSink
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    Segmentation,
)
from mlbs_actors.source import SourceFrame
from mlbs_actors.stored_motion import StoredMotion
from orchestrator.sinks.outer_record import OuterRecord

__all__ = ["SPARE", "RecordingParts", "RecordingSink"]

#: Kind of a layer process that has not been a layer yet.
SPARE = "spare layer"

#: Among the stages of a label map on its way to the sink: when it was made.
_LABELLED = "labelled"


@dataclass(frozen=True)
class RecordingParts:
    """Wrap other parts; keep a file with its role for each layer process, and one for each on standby."""

    parts: PartFactory
    folder: Path
    standby: Path

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        """See :class:`PartFactory`."""
        self._leave_standby()
        return self.parts.coordinator(config, ignored, motion)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """See :class:`PartFactory`."""
        if self._own_file.exists():  # else the layer starts in the segmenter's process
            self._record_kind("background layer" if kind == "background" else "object layer")
        return self.parts.layer(config, layer, kind)

    def segmenter(self, config: Config) -> SegmenterPart:
        """See :class:`PartFactory`."""
        self._leave_standby()
        return _TimestampingSegmenter(self.parts.segmenter(config))

    def warm_layer(self) -> None:
        """See :class:`PartFactory`."""
        self.parts.warm_layer()
        self._record_kind(SPARE)

    def warm_coordinator(self) -> None:
        """See :class:`PartFactory`."""
        self.parts.warm_coordinator()
        (self.standby / str(os.getpid())).touch()

    def warm_segmenter(self) -> None:
        """See :class:`PartFactory`."""
        self.parts.warm_segmenter()
        (self.standby / str(os.getpid())).touch()

    def _leave_standby(self) -> None:
        (self.standby / str(os.getpid())).unlink(missing_ok=True)

    def _record_kind(self, kind: str) -> None:
        self._own_file.write_text(kind, encoding="utf-8")

    @property
    def _own_file(self) -> Path:
        return self.folder / str(os.getpid())


class _TimestampingSegmenter:
    """Wrap another segmenter; add to each label map when it was made."""

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


class RecordingSink(OuterRecord):
    """Write a line for each label map that arrives, besides another record."""

    def __init__(self, open_sink: Callable[[], StreamSink], file: Path) -> None:
        super().__init__(open_sink)
        self._file = file.open("w", encoding="ascii", buffering=1)

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """See :class:`StreamSink`."""
        objects = " ".join(str(layer.layer) for layer in segmentation.layers)
        stage_ms = dict(segmentation.stage_ms)
        labelled = stage_ms.pop(_LABELLED)
        self._file.write(f"{time.monotonic()} {labelled} {frame.index} {objects}\n")
        return super().write(replace(segmentation, stage_ms=stage_ms), frame, background)

    def close(self, *, whole: bool) -> int:
        """See :class:`StreamSink`."""
        self._file.close()
        return super().close(whole=whole)
