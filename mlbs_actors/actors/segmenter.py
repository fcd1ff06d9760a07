"""The segmenter of a stream in a process of its own."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.saved_states import PUBLISHED_FILE, SEGMENTER_FILE, PublishedState, StateWriter
from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.messages import FrameEvidence, LayerPosterior, Segmentation
from mlbs_actors.state_file import read_state

__all__ = ["SegmenterActor"]


class SegmenterActor:
    """Labels the frames of one stream, each once and in order."""

    def __init__(self, parts: PartFactory, config: Config) -> None:
        limit_process()
        self._segmenter = parts.segmenter(config)
        self._memory = SharedMemory()
        self._order = FrameOrder()
        # Those that others may still ask for: the layers the last one, the coordinator that before it.
        self._published: deque[Segmentation] = deque(maxlen=2)
        self._writer = StateWriter()

    def step(
        self,
        shared_evidence: Shared[FrameEvidence],
        shared_frame: Shared[SourceFrame],
        slot: Slot,
        *shared_posteriors: Shared[LayerPosterior],
    ) -> Shared[Segmentation]:
        """Label one frame from the posteriors of its layers, in ascending layer id."""
        evidence, frame = self._memory.taken(shared_evidence), self._memory.taken(shared_frame)
        assert frame.image is not None  # a quarantined frame has no evidence
        posteriors = [self._memory.taken(one) for one in shared_posteriors]
        with self._order.step(evidence.frame_index, after=evidence.frame_index - 1):
            segmentation = self._segmenter.step(evidence, frame.image, posteriors)
        self._published.append(segmentation)
        return self._memory.share(segmentation, slot)

    def save(self, folder: Path) -> None:
        """Write the state into a snapshot's folder, beside the work on the next frames."""
        published = PublishedState(tuple(self._published))
        self._writer.write({SEGMENTER_FILE: self._segmenter.state, PUBLISHED_FILE: published}, folder)

    def restore(self, folder: Path) -> tuple[Segmentation, ...]:
        """Go back to a snapshot; return the newest label maps at that time."""
        self._segmenter.state = read_state(folder / SEGMENTER_FILE, type(self._segmenter.state))
        published = read_state(folder / PUBLISHED_FILE, PublishedState)
        self._published.extend(published.segmentations)
        self._order = FrameOrder(published.segmentations[-1].frame_index if published.segmentations else -1)
        return published.segmentations
