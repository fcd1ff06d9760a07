"""One layer a process, and the coordinator's list of those that live."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import ray

from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.parts import LayerPart, PartFactory
from mlbs_actors.actors.processes import Handle, Reference, identity
from mlbs_actors.actors.saved_states import SavedLayer, StateWriter, layer_file
from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot
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
from mlbs_actors.state_file import read_state

__all__ = ["LayerActor", "LiveLayers"]


class LayerActor:
    """A warm process that is one layer after the other, of whatever stream.

    Calls carry the number of the start of a stream that they belong to: those of a stream that has lost its
    coordinator may still come when the process is another stream's layer, and do nothing then.
    """

    def __init__(self, parts: PartFactory) -> None:
        limit_process()
        parts.warm_layer()
        self._parts = parts
        self._part: LayerPart | None = None
        self._writer = StateWriter()

    def assign(self, run: int, own: SavedLayer, config: Config, folder: Path | None) -> None:
        """Become a layer: a new-born one, or that of the snapshot in ``folder``."""
        self._run = run
        self._layer = own.layer
        self._part = self._parts.layer(config, own.layer, own.kind)
        self._memory = SharedMemory()
        self._order = FrameOrder(own.last_frame)
        if folder is not None:
            self._part.state = read_state(folder / layer_file(own.layer), type(self._part.state))

    def step(
        self,
        run: int,
        shared_evidence: Shared[FrameEvidence],
        shared_frame: Shared[SourceFrame],
        shared_previous: Shared[Segmentation] | None,
        slot: Slot,
    ) -> Shared[LayerPosterior]:
        """Finish the frame before with its labels, then evaluate this one; each frame once and in order."""
        if self._part is None or run != self._run:
            raise LayerError("A frame came to a process that is no layer of that stream; assign it.")
        evidence, frame = self._memory.taken(shared_evidence), self._memory.taken(shared_frame)
        previous = None if shared_previous is None else self._memory.taken(shared_previous)
        assert frame.image is not None  # a quarantined frame has no evidence
        own = next(own for own in evidence.layers if own.layer == self._layer)
        with self._order.step(evidence.frame_index, after=own.last_frame):
            return self._memory.share(self._part.step(own, evidence, frame.image, previous), slot)

    def appearance(self) -> LayerAppearance:
        """Return what the layer remembers at the frame it did last."""
        assert self._part is not None  # asked for by whoever asked for that frame
        return self._part.appearance()

    def save(self, run: int, folder: Path) -> None:
        """Write the state into a snapshot's folder, beside the work on the next frames."""
        if self._part is not None and run == self._run:
            self._writer.write({layer_file(self._layer): self._part.state}, folder)

    def release(self, run: int) -> None:
        """Forget the layer, and with it its memory."""
        if self._part is not None and run == self._run:
            self._part = None
            del self._memory


@dataclass(slots=True)
class _Lent:
    """A layer's process, and how far it has been asked to go."""

    handle: Handle
    kind: LayerKind
    last_frame: int


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
        self._lent: dict[int, _Lent] = {}

    def __len__(self) -> int:
        return len(self._lent)

    def roles(self) -> Iterator[tuple[str, str]]:
        """Actor id and name of every layer process, for messages."""
        for layer, lent in self._lent.items():
            yield identity(lent.handle), f"layer {layer}"

    def state(self) -> tuple[SavedLayer, ...]:
        """The layers as they stand, in ascending id."""
        return tuple(
            SavedLayer(layer, lent.kind, lent.last_frame) for layer, lent in sorted(self._lent.items())
        )

    def save(self, folder: Path) -> None:
        """Let every layer write its state after the last frame it was asked for."""
        for lent in self._lent.values():
            lent.handle.save.remote(self._run, folder)

    def restore(self, layers: Iterable[SavedLayer], folder: Path) -> None:
        """Go back to a snapshot; raises RayError as :meth:`follow`."""
        self._acquire(layers, folder)

    def follow(self, evidence: FrameEvidence) -> None:
        """Give the retired layers' processes back, and wait for a process for every layer just born.

        Raises
        ------
        RayError
            If the pool could not start a process, or is gone.
        """
        for layer in evidence.retired:
            if layer in self._lent:
                self._release(layer)
        born = [own for own in evidence.layers if own.layer not in self._lent]
        self._acquire([SavedLayer(own.layer, own.kind, -1) for own in born], None)

    def step(
        self,
        evidence: FrameEvidence,
        shared: Shared[FrameEvidence],
        frame: Shared[SourceFrame],
        previous: Reference | None,
        slots: Sequence[Slot],
    ) -> list[Reference]:
        """Start the frame's work in every layer that has evidence.

        Parameters
        ----------
        evidence, shared : FrameEvidence
            By value, and for the layers.
        frame : Shared
        previous : Reference, optional
            To where the label map before it will be.
        slots : sequence of Slot
            One for each layer of the evidence.

        Returns
        -------
        list of Reference
            To where the posteriors will be, in ascending layer id.
        """
        posteriors = []
        for own, slot in zip(evidence.layers, slots, strict=True):
            lent = self._lent[own.layer]
            lent.last_frame = evidence.frame_index
            posteriors.append(lent.handle.step.remote(self._run, shared, frame, previous, slot))
        return posteriors

    def background(self) -> Reference:
        """Ask the background for its :class:`LayerAppearance` at the frame whose work was started last."""
        appearance: Reference = self._lent[BACKGROUND].handle.appearance.remote()
        return appearance

    def release_all(self) -> None:
        """Give all processes back, each once its last step is done."""
        for layer in list(self._lent):
            self._release(layer)

    def _acquire(self, layers: Iterable[SavedLayer], folder: Path | None) -> None:
        wanted = list(layers)
        asked = [self._pool.acquire.remote(self._run, own, self._config, folder) for own in wanted]
        for own, handle in zip(wanted, ray.get(asked), strict=True):
            self._lent[own.layer] = _Lent(handle, own.kind, own.last_frame)

    def _release(self, layer: int) -> None:
        # The layer's own answer is an argument of the pool's call, so the pool hears of it only when the
        # process has done all its steps.
        handle = self._lent.pop(layer).handle
        self._pool.release.remote(self._run, identity(handle), handle.release.remote(self._run))
