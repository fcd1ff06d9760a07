"""One layer a process, and the coordinator's list of those that live."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import ray

from mlbs_actors.actors.channels import ChannelOffer, OfferedChannel
from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.parts import LayerPart, PartFactory
from mlbs_actors.actors.priority import stepping_back
from mlbs_actors.actors.processes import Handle, Reference, identity
from mlbs_actors.actors.saved_states import SavedLayer, SaveState, StateWriter, layer_file
from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.messages import FrameEvidence, LayerKind, LayerPosterior, Segmentation
from mlbs_actors.pickling import pickled_by_values
from mlbs_actors.process_memory import settle_memory
from mlbs_actors.state_file import read_state

__all__ = ["LayerActor", "LayerOffers", "LayerStep", "LiveLayers"]

#: Layers, and the channels through which their steps are to come.
LayerOffers: TypeAlias = tuple[tuple[int, ChannelOffer], ...]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerStep:
    """A frame that a layer is to do.

    Attributes
    ----------
    evidence, frame : Shared
    previous : Shared, optional
        The label map of the frame before.
    answer : Slot
        For the posterior.
    appearance : Slot, optional
        For what the layer remembers after that; None if nobody wants it.
    """

    evidence: Shared[FrameEvidence]
    frame: Shared[SourceFrame]
    previous: Shared[Segmentation] | None
    answer: Slot
    appearance: Slot | None = None


class LayerActor:
    """A warm process that is one layer after the other, of whatever stream.

    Calls carry the number of the start of a stream that they belong to: those of a stream that has lost its
    coordinator may still come when the process is another stream's layer, and do nothing then.

    Parameters
    ----------
    parts : PartFactory
    awaited : bool
        Whether somebody waits for the process.
    """

    def __init__(self, parts: PartFactory, awaited: bool) -> None:
        limit_process()
        with stepping_back(awaited=awaited):
            parts.warm_layer()
        settle_memory()
        self._parts = parts
        self._part: LayerPart | None = None
        self._writer = StateWriter()

    def assign(self, run: int, own: SavedLayer, config: Config, folder: Path | None) -> ChannelOffer:
        """Become a layer: a new-born one, or that of the snapshot in ``folder``.

        Returns
        -------
        ChannelOffer
            Of the channel through which its steps are to come.
        """
        self._run = run
        self._layer = own.layer
        self._part = self._parts.layer(config, own.layer, own.kind)
        self._memory = SharedMemory()
        self._order = FrameOrder(own.last_frame)
        self._channel = OfferedChannel()
        if folder is not None:
            self._part.state = read_state(folder / layer_file(own.layer), type(self._part.state))
        return self._channel.offer

    def serve(self, run: int) -> None:
        """Do the steps that come, and save the state where that is asked for, until no more can come."""
        if self._part is None or run != self._run:
            return
        self._channel.serve(self._answers)
        self._writer.finish()

    def step(self, step: LayerStep) -> Shared[LayerPosterior]:
        """Finish the frame before with its labels, then evaluate this one; each frame once and in order."""
        assert self._part is not None  # assigned
        evidence, frame = self._memory.taken(step.evidence), self._memory.taken(step.frame)
        previous = None if step.previous is None else self._memory.taken(step.previous)
        assert frame.image is not None  # a quarantined frame has no evidence
        own = next(own for own in evidence.layers if own.layer == self._layer)
        with self._order.step(evidence.frame_index, after=own.last_frame):
            return self._memory.share(self._part.step(own, evidence, frame.image, previous), step.answer)

    def save(self, note: SaveState) -> None:
        """Write the state, beside the work on the next frames."""
        assert self._part is not None  # assigned
        self._writer.write({layer_file(self._layer): self._part.state}, note.folder)

    def release(self, run: int) -> None:
        """Forget the layer, and with it its memory."""
        if self._part is not None and run == self._run:
            self._part = None
            del self._memory

    def _answers(self, note: LayerStep | SaveState) -> Iterator[object]:
        assert self._part is not None  # assigned
        if isinstance(note, SaveState):
            self.save(note)
            return
        yield self.step(note)
        if note.appearance is not None:
            yield self._memory.share(self._part.appearance(), note.appearance)


@dataclass(slots=True)
class _Lent:
    """A layer's process, how far it has been asked to go, and what says that it serves no more."""

    handle: Handle
    kind: LayerKind
    last_frame: int
    served: Reference


class LiveLayers:
    """The coordinator's list of its layer processes: layer id → process, over births and retirements.

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

    def served(self) -> list[Reference]:
        """What raises why a layer's process serves no more, where that failed or is gone."""
        return [lent.served for lent in self._lent.values()]

    def state(self) -> tuple[SavedLayer, ...]:
        """The layers as they stand, in ascending id."""
        return tuple(
            SavedLayer(layer, lent.kind, lent.last_frame) for layer, lent in sorted(self._lent.items())
        )

    def restore(self, layers: Iterable[SavedLayer], folder: Path) -> LayerOffers:
        """Go back to a snapshot; as :meth:`follow`."""
        return self._acquire(layers, folder)

    def follow(self, evidence: FrameEvidence) -> LayerOffers:
        """Give the retired layers' processes back, and wait for a process for every layer just born.

        Returns
        -------
        LayerOffers
            Of the layers just born.

        Raises
        ------
        RayError
            If the pool could not start a process, or is gone.
        """
        for layer in evidence.retired:
            if layer in self._lent:
                self._release(layer)
        born = [own for own in evidence.layers if own.layer not in self._lent]
        offers = self._acquire([SavedLayer(own.layer, own.kind, -1) for own in born], None)
        for own in evidence.layers:
            self._lent[own.layer].last_frame = evidence.frame_index
        return offers

    def release_all(self) -> None:
        """Give all processes back, each once it serves no more."""
        for layer in list(self._lent):
            self._release(layer)

    def _acquire(self, layers: Iterable[SavedLayer], folder: Path | None) -> LayerOffers:
        wanted = list(layers)
        asked = [self._pool.acquire.remote(self._run, own, self._config, folder) for own in wanted]
        offers = []
        for own, (handle, offer) in zip(wanted, ray.get(asked), strict=True):
            served: Reference = handle.serve.remote(self._run)
            self._lent[own.layer] = _Lent(handle, own.kind, own.last_frame, served)
            offers.append((own.layer, offer))
        return tuple(offers)

    def _release(self, layer: int) -> None:
        # The layer's own answer is an argument of the pool's call, so the pool hears of it only when the
        # process has done all its steps.
        handle = self._lent.pop(layer).handle
        self._pool.release.remote(self._run, identity(handle), handle.release.remote(self._run))
