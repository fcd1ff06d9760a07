"""One layer: what it does for each frame, and the process that it has for itself."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

from mlbs_actors.actors.ipc.channels import ChannelOffer, OfferedChannel
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.node.idle_threads import look_round_seldom
from mlbs_actors.actors.node.priority import stepping_back
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.actors.parts import LayerPart, PartFactory
from mlbs_actors.actors.stream.order import FrameOrder
from mlbs_actors.actors.stream.protocol import SourceFrame
from mlbs_actors.actors.stream.saved_states import SavedLayer, SaveState, StateWriter, layer_file
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import LayerError
from mlbs_actors.messages import Array, FrameEvidence, LayerAppearance, LayerPosterior, Segmentation
from mlbs_actors.pickling import pickled_by_values
from mlbs_actors.state_file import CapturedState, capture

__all__ = ["LayerActor", "LayerStart", "LayerStep", "LayerWork"]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerStart:
    """The layer that a process is to be from now on, and the state of its part."""

    own: SavedLayer
    state: Shared[CapturedState]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerStep:
    """A frame that a layer is to do.

    Attributes
    ----------
    evidence, frame : Shared
    previous : Shared, optional
        Published result of the frame before; None if there is none.
    answer : Slot
        For the posterior.
    appearance : Slot, optional
        For what the layer remembers after that; None if nobody wants it.
    """

    evidence: Shared[FrameEvidence]
    frame: Shared[SourceFrame]
    previous: Shared[Segmentation] | None
    answer: Slot
    appearance: Slot | None


class LayerWork:
    """One layer at work, in whatever process.

    Parameters
    ----------
    own : SavedLayer
        How far it has come.
    part : LayerPart
        In the state of that frame.
    memory : SharedMemory
        Of the process.

    Attributes
    ----------
    part : LayerPart
    """

    def __init__(self, own: SavedLayer, part: LayerPart, memory: SharedMemory) -> None:
        self.part = part
        self._own = own
        self._memory = memory
        self._order = FrameOrder(own.last_frame)

    def step(self, evidence: FrameEvidence, image: Array, previous: Segmentation | None) -> LayerPosterior:
        """Finish the frame before with its labels, then evaluate this one; each frame once and in order."""
        before = evidence.tracks_of(self._own.layer).last_frame
        with self._order.step(evidence.frame_index, after=before):
            return self.part.step(evidence, image, previous)

    def appearance(self, slot: Slot) -> Shared[LayerAppearance]:
        """Return what the layer remembers after its last step."""
        return self._memory.share(self.part.appearance(), slot)

    def saved(self) -> dict[str, object]:
        """Return what a snapshot is to hold of it, by the name of the file."""
        return {layer_file(self._own.layer): self.part.state}

    def hand_over(self, slot: Slot) -> LayerStart:
        """What another process goes on with."""
        last = self._order.last
        if last is None:
            raise LayerError(f"Layer {self._own.layer} has failed; start the stream again.")
        own = SavedLayer(self._own.layer, self._own.kind, last)
        return LayerStart(own, self._memory.share(capture(self.part.state), slot))


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
        look_round_seldom()
        with stepping_back(awaited=awaited):
            parts.warm_layer()
        settle_memory()
        self._parts = parts
        self._run: int | None = None
        self._work: LayerWork | None = None
        self._writer = StateWriter()

    def process_id(self) -> int:
        """Return the process's id, once it is ready."""
        return os.getpid()

    def assign(self, run: int, config: Config) -> ChannelOffer:
        """Be a layer of a stream, whichever its segmenter says.

        Returns
        -------
        ChannelOffer
            Of the channel through which the layer and its steps are to come.
        """
        self._run = run
        self._config = config
        self._memory = SharedMemory()
        self._channel = OfferedChannel()
        return self._channel.offer

    def serve(self, run: int) -> None:
        """Do the steps that come, and save the state where that is asked for, until no more can come."""
        if run == self._run:
            self._channel.serve(self._answers)
            self._writer.finish()

    def begin(self, start: LayerStart) -> None:
        """Become a layer, which goes on where the segmenter has left it."""
        own = start.own
        part = self._parts.layer(self._config, own.layer, own.kind)
        part.state = self._memory.taken(start.state).state(type(part.state))
        self._work = LayerWork(own, part, self._memory)

    def step(self, step: LayerStep) -> Shared[LayerPosterior]:
        """See :meth:`LayerWork.step`."""
        assert self._work is not None  # begun
        evidence, frame = self._memory.taken(step.evidence), self._memory.taken(step.frame)
        previous = None if step.previous is None else self._memory.taken(step.previous)
        assert frame.image is not None  # a quarantined frame has no evidence
        return self._memory.share(self._work.step(evidence, frame.image, previous), step.answer)

    def save(self, note: SaveState) -> None:
        """Write the state, beside the work on the next frames."""
        assert self._work is not None  # begun
        self._writer.write(self._work.saved(), note.folder)

    def release(self, run: int) -> None:
        """Forget the layer, and with it its memory."""
        if run == self._run:
            self._run = self._work = None
            del self._memory, self._channel

    def _answers(self, message: LayerStart | LayerStep | SaveState) -> Iterator[object]:
        if isinstance(message, LayerStart):
            self.begin(message)
        elif isinstance(message, SaveState):
            self.save(message)
        else:
            yield self.step(message)
            if message.appearance is not None:
                assert self._work is not None  # begun
                yield self._work.appearance(message.appearance)
