"""The segmenter of a stream in a process of its own."""

from __future__ import annotations

from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.messages import FrameEvidence, LayerPosterior, Segmentation

__all__ = ["SegmenterActor"]


class SegmenterActor:
    """Labels the frames of one stream, each once and in order."""

    def __init__(self, parts: PartFactory, config: Config) -> None:
        limit_process()
        self._segmenter = parts.segmenter(config)
        self._order = FrameOrder()

    def step(self, evidence: FrameEvidence, frame: SourceFrame, *posteriors: LayerPosterior) -> Segmentation:
        """Label one frame from the posteriors of its layers, in ascending layer id."""
        assert frame.image is not None  # a quarantined frame has no evidence
        with self._order.step(evidence.frame_index, after=evidence.frame_index - 1):
            return self._segmenter.step(evidence, frame.image, list(posteriors))
