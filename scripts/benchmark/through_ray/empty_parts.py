"""Parts that compute nothing: they send the engine's own messages of one frame for every frame.

With them the actors make the same calls with the same payloads; what remains is the cost of Ray, and of the
actors themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.actors.parts import CoordinatorPart, LayerPart, SegmenterPart
from mlbs_actors.actors.stream.protocol import Opening, Snapshot
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
)
from mlbs_actors.segmentation.segmenter import Segmenter
from mlbs_actors.source import GapStatus, SourceFrame
from mlbs_actors.stored_motion import StoredMotion

__all__ = ["EmptyParts", "EmptyReader", "EmptySink", "FrameMessages", "last_messages"]


@dataclass(frozen=True)
class FrameMessages:
    """All messages between the parts for one frame.

    Attributes
    ----------
    evidence : FrameEvidence
    posteriors : tuple of LayerPosterior
        One for each layer of the evidence.
    segmentation : Segmentation
    """

    evidence: FrameEvidence
    posteriors: tuple[LayerPosterior, ...]
    segmentation: Segmentation


class _CapturingSegmenter(Segmenter):
    """The engine's segmenter, which receives and returns all messages of a frame; keeps the last ones."""

    captured: FrameMessages

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        segmentation = super().step(evidence, frame, posteriors)
        self.captured = FrameMessages(evidence, tuple(posteriors), segmentation)
        return segmentation


def last_messages(frames: Iterable[Array], config: Config) -> FrameMessages:
    """Run the engine in this process; return the messages of the last frame."""
    engine = MultilayerSubtractor(config)
    engine._segmenter = segmenter = _CapturingSegmenter(config)
    for frame in frames:
        engine.apply(frame)
    engine.flush()
    return segmenter.captured


@dataclass(frozen=True)
class NoState:
    """State of a part that has none."""


@dataclass
class _EmptyCoordinator:
    evidence: FrameEvidence
    state: NoState = NoState()

    def feedback_index(self, frame_index: int) -> int | None:
        return None if frame_index < 2 else frame_index - 2

    def step(
        self,
        frame_index: int,
        frame: Array,
        feedback: Callable[[], Segmentation] | None,
        concealed: bool = False,
    ) -> list[FrameEvidence]:
        if feedback is not None:
            feedback()
        tracks = tuple(one._replace(last_frame=frame_index - 1) for one in self.evidence.tracks)
        return [replace(self.evidence, frame_index=frame_index, tracks=tracks, retired=())]

    def begin_anew(self) -> list[FrameEvidence]:
        """Never asked for."""
        return self.flush()

    def flush(self) -> list[FrameEvidence]:
        return []


@dataclass
class _EmptyLayer:
    posterior: LayerPosterior
    state: NoState = NoState()

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> LayerPosterior:
        return replace(self.posterior, frame_index=evidence.frame_index)

    def appearance(self) -> LayerAppearance:
        nothing = np.zeros((0, 0, 3), np.uint8)
        return LayerAppearance(0, 0, Region(0, 0, 0, 0), nothing, np.zeros((0, 0), np.bool_))


@dataclass
class _EmptySegmenter:
    segmentation: Segmentation
    state: NoState = NoState()

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        return replace(self.segmentation, frame_index=evidence.frame_index)


@dataclass(frozen=True)
class EmptyParts:
    """A ``PartFactory`` of parts that answer at once with the messages of one frame."""

    messages: FrameMessages

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        """Make a coordinator that returns the same evidence for every frame."""
        return _EmptyCoordinator(self.messages.evidence)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer that returns the same posterior for every frame."""
        return _EmptyLayer(next(one for one in self.messages.posteriors if one.layer == layer))

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a segmenter that returns the same label map for every frame."""
        return _EmptySegmenter(self.messages.segmentation)

    def warm_layer(self) -> None:
        """Do nothing: there is nothing to compile."""

    def warm_coordinator(self) -> None:
        """Do nothing: there is nothing to compile."""

    def warm_segmenter(self) -> None:
        """Do nothing: there is nothing to compile."""


@dataclass
class EmptyReader:
    """A reader that delivers one picture without end."""

    image: Array
    problem: str | None = None
    _next: int = 0

    def read(self) -> SourceFrame:
        """Return the picture again."""
        index, self._next = self._next, self._next + 1
        return SourceFrame(index, self.image, float(index), f"{index:05d}")

    def close(self) -> None:
        """Do nothing: no file is open."""


@dataclass
class EmptySink:
    """A sink that writes nothing."""

    rows: int = 0
    opening: Opening = field(default_factory=Opening)

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Count the row."""
        self.rows += 1
        return self.rows

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Ignore the gap."""
        return self.rows

    def keep(self, snapshot: Snapshot) -> bool:
        """Decline the snapshot; none is requested."""
        return False

    def configure(self, settings: object) -> None:
        """Do nothing: there is nothing to follow."""

    def silent(self) -> None:
        """Do nothing: nothing is recorded."""

    def provisional(self) -> None:
        """Do nothing: nothing is recorded."""

    def close(self, *, whole: bool) -> int:
        """Return the number of rows."""
        return self.rows
