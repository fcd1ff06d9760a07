"""Parts that do nothing: the engine's own messages of one frame, sent for every frame.

With them the actors make the same calls with the same payloads, and what is left is the cost of Ray, and of
what the actors themselves do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.actors.ipc.shared_memory import SharedMemory
from mlbs_actors.actors.parts import CoordinatorPart, LayerPart, SegmenterPart
from mlbs_actors.actors.stream.protocol import GapStatus, Opening, Snapshot, SourceFrame
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

__all__ = ["EmptyParts", "EmptyReader", "EmptySink", "FrameMessages", "last_messages"]


@dataclass(frozen=True)
class FrameMessages:
    """All that passes between the parts for one frame.

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


class _HeardSegmenter(Segmenter):
    """The engine's segmenter, which hears and says everything about a frame; remembers it."""

    heard: FrameMessages

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        segmentation = super().step(evidence, frame, posteriors)
        self.heard = FrameMessages(evidence, tuple(posteriors), segmentation)
        return segmentation


def last_messages(frames: Iterable[Array], config: Config) -> FrameMessages:
    """Run the engine in this process; return the messages of the last frame."""
    engine = MultilayerSubtractor(config)
    engine._segmenter = segmenter = _HeardSegmenter(config)
    for frame in frames:
        engine.apply(frame)
    engine.flush()
    return segmenter.heard


@dataclass(frozen=True)
class NoState:
    """State of a part that remembers nothing."""


@dataclass
class _EmptyCoordinator:
    evidence: FrameEvidence
    state: NoState = NoState()

    def feedback_index(self, frame_index: int) -> int | None:
        return None if frame_index < 2 else frame_index - 2

    def step(
        self, frame_index: int, frame: Array, feedback: Callable[[], Segmentation] | None
    ) -> list[FrameEvidence]:
        if feedback is not None:
            feedback()
        tracks = tuple(one._replace(last_frame=frame_index - 1) for one in self.evidence.tracks)
        return [replace(self.evidence, frame_index=frame_index, tracks=tracks, retired=())]

    def flush(self) -> list[FrameEvidence]:
        return []


@dataclass
class _EmptyLayer:
    posterior: LayerPosterior
    state: NoState = NoState()

    def step(self, evidence: FrameEvidence, frame: Array, previous: Segmentation | None) -> LayerPosterior:
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
    """Makes parts that answer at once with the messages of one frame; a ``PartFactory``."""

    messages: FrameMessages

    def coordinator(self, config: Config) -> CoordinatorPart:
        """Make a coordinator that finds the same in every frame."""
        return _EmptyCoordinator(self.messages.evidence)

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        """Make a layer that has the same posterior in every frame."""
        return _EmptyLayer(next(one for one in self.messages.posteriors if one.layer == layer))

    def loop(self, part: LayerPart, memory: SharedMemory) -> None:
        """There is none."""

    def segmenter(self, config: Config) -> SegmenterPart:
        """Make a segmenter that gives the same label map for every frame."""
        return _EmptySegmenter(self.messages.segmentation)

    def warm_layer(self) -> None:
        """Nothing is to be compiled."""

    def warm_stream(self) -> None:
        """Nothing is to be imported."""


@dataclass
class EmptyReader:
    """Delivers one picture for ever."""

    image: Array
    problem: str | None = None
    _next: int = 0

    def read(self) -> SourceFrame:
        """Return the picture again."""
        index, self._next = self._next, self._next + 1
        return SourceFrame(index, self.image, float(index), f"{index:05d}")

    def close(self) -> None:
        """Nothing is held open."""


@dataclass
class EmptySink:
    """Writes nothing."""

    rows: int = 0
    opening: Opening = field(default_factory=Opening)

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Count the row."""
        self.rows += 1
        return self.rows

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Pass over it."""
        return self.rows

    def keep(self, snapshot: Snapshot) -> bool:
        """None is offered, since none is asked for."""
        return False

    def provisional(self) -> None:
        """Nothing is kept."""

    def close(self, *, whole: bool) -> int:
        """Return the number of rows."""
        return self.rows
