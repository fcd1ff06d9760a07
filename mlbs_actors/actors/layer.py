"""One layer a process, and the coordinator's list of those that live."""

from __future__ import annotations

from collections.abc import Iterator

import ray

from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.parts import LayerPart, PartFactory
from mlbs_actors.actors.processes import Handle, Reference, identity
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import LayerError
from mlbs_actors.messages import (
    BACKGROUND,
    FrameEvidence,
    LayerAppearance,
    LayerKind,
    LayerPosterior,
    Segmentation,
)

__all__ = ["LayerActor", "LiveLayers"]


class LayerActor:
    """A warm process that is one layer after the other, of whatever stream."""

    def __init__(self, parts: PartFactory) -> None:
        limit_process()
        parts.warm_layer()
        self._parts = parts
        self._part: LayerPart | None = None

    def assign(self, layer: int, kind: LayerKind, config: Config) -> None:
        """Become a new-born layer."""
        self._layer = layer
        self._part = self._parts.layer(config, layer, kind)
        self._order = FrameOrder()

    def step(
        self, evidence: FrameEvidence, frame: SourceFrame, previous: Segmentation | None
    ) -> LayerPosterior:
        """Finish the frame before with its labels, then evaluate this one; each frame once and in order."""
        if self._part is None:
            raise LayerError(
                f"Frame {evidence.frame_index} came to a process that is no layer; assign it first."
            )
        assert frame.image is not None  # a quarantined frame has no evidence
        own = next(own for own in evidence.layers if own.layer == self._layer)
        with self._order.step(evidence.frame_index, after=own.last_frame):
            return self._part.step(own, evidence, frame.image, previous)

    def appearance(self) -> LayerAppearance:
        """Return what the layer remembers at the frame it did last."""
        assert self._part is not None  # asked for by whoever asked for that frame
        return self._part.appearance()

    def release(self) -> None:
        """Forget the layer, and with it its memory."""
        self._part = None


class LiveLayers:
    """The coordinator's end of its layer processes: layer id → process, over births and retirements.

    Parameters
    ----------
    pool : Handle
        The node's :class:`~mlbs_actors.actors.pool.PoolActor`.
    run : int
        The stream's number in that pool.
    config : Config
    """

    def __init__(self, pool: Handle, run: int, config: Config) -> None:
        self._pool = pool
        self._run = run
        self._config = config
        self._handles: dict[int, Handle] = {}

    def __len__(self) -> int:
        return len(self._handles)

    def roles(self) -> Iterator[tuple[str, str]]:
        """Actor id and name of every layer process, for messages."""
        for layer, handle in self._handles.items():
            yield identity(handle), f"layer {layer}"

    def follow(self, evidence: FrameEvidence) -> None:
        """Give the retired layers' processes back, and wait for a process for every layer just born.

        Raises
        ------
        RayError
            If the pool could not start a process, or is gone.
        """
        for layer in evidence.retired:
            if layer in self._handles:
                self._release(layer)
        born = [own for own in evidence.layers if own.layer not in self._handles]
        asked = [self._pool.acquire.remote(self._run, own.layer, own.kind, self._config) for own in born]
        for own, handle in zip(born, ray.get(asked), strict=True):
            self._handles[own.layer] = handle

    def step(
        self, evidence: FrameEvidence, by_reference: Reference, frame: Reference, previous: Reference | None
    ) -> list[Reference]:
        """Start the frame's work in every layer that has evidence; one posterior each, in ascending id."""
        return [
            self._handles[own.layer].step.remote(by_reference, frame, previous) for own in evidence.layers
        ]

    def background(self) -> Reference:
        """Ask the background for its :class:`LayerAppearance` at the frame whose work was started last."""
        appearance: Reference = self._handles[BACKGROUND].appearance.remote()
        return appearance

    def release_all(self) -> None:
        """Give all processes back, each once its last step is done."""
        for layer in list(self._handles):
            self._release(layer)

    def _release(self, layer: int) -> None:
        # The layer's own answer is an argument of the pool's call, so the pool hears of it only when the
        # process has done all its steps.
        handle = self._handles.pop(layer)
        self._pool.release.remote(self._run, identity(handle), handle.release.remote())
