"""A layer in any process, and the actor that runs one in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator

from mlbs_actors.actors.ipc.channels import ChannelAddress, ChannelListener
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.priority import stepping_back
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.actors.parts import LayerPart, PartFactory
from mlbs_actors.actors.stream.messages import LayerStart, LayerStep, SaveState
from mlbs_actors.actors.stream.order import FrameOrder
from mlbs_actors.actors.stream.saved_states import SavedLayer, StateWriter, layer_file
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import LayerError
from mlbs_actors.messages import FrameEvidence, LayerAppearance, LayerPosterior, Segmentation
from mlbs_actors.state_file import capture

__all__ = ["LayerActor", "LayerWork"]


class LayerWork:
    """One layer and its frame order, in any process.

    Parameters
    ----------
    own : SavedLayer
        With the last frame done.
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

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> LayerPosterior:
        """Finish the frame before with its labels, then evaluate this one; each frame once and in order."""
        before = evidence.tracks_of(self._own.layer).last_frame
        with self._order.step(evidence.frame_index, after=before):
            return self.part.step(evidence, previous)

    def appearance(self, slot: Slot) -> Shared[LayerAppearance]:
        """Share the remembered colours after the last step."""
        return self._memory.share(self.part.appearance(), slot)

    def saved(self) -> dict[str, object]:
        """Return its part of a snapshot, by file name."""
        return {layer_file(self._own.layer): self.part.state}

    def hand_over(self, slot: Slot) -> LayerStart:
        """Share the state for another process, which will continue from it."""
        last = self._order.last
        if last is None:
            raise LayerError(f"Layer {self._own.layer} has failed; start the stream again.")
        own = SavedLayer(self._own.layer, self._own.kind, last)
        return LayerStart(own, self._memory.share(capture(self.part.state), slot))


class LayerActor:
    """A warm process that runs one layer after the other, of any stream.

    Calls carry the number of their stream's start: late calls of a stream that lost its coordinator are
    ignored when the process belongs to another stream.

    Parameters
    ----------
    parts : PartFactory
    """

    def __init__(self, parts: PartFactory) -> None:
        limit_process()
        relax_thread_timers()
        with stepping_back():  # until then the layer is in the segmenter's process
            parts.warm_layer()
        settle_memory()
        self._parts = parts
        self._run: int | None = None
        self._work: LayerWork | None = None
        self._writer = StateWriter()

    def process_id(self) -> int:
        """Return the process's id, once it is ready."""
        return os.getpid()

    def assign(self, run: int, config: Config) -> ChannelAddress:
        """Join a stream, whose segmenter will choose the layer.

        Returns
        -------
        ChannelAddress
            Of the channel for the layer and its steps.
        """
        self._run = run
        self._config = config
        self._memory = SharedMemory()
        self._channel = ChannelListener()
        return self._channel.address

    def serve(self, run: int) -> None:
        """Process steps and save requests until the channel is closed."""
        if run == self._run:
            self._channel.serve(self._answers)
            self._writer.finish()

    def begin(self, start: LayerStart) -> None:
        """Become a layer, from the state that the segmenter has shared."""
        own = start.own
        part = self._parts.layer(self._config, own.layer, own.kind)
        part.state = self._memory.load(start.state).state(type(part.state))
        self._work = LayerWork(own, part, self._memory)

    def step(self, step: LayerStep) -> Shared[LayerPosterior]:
        """See :meth:`LayerWork.step`."""
        assert self._work is not None  # begun
        evidence = self._memory.load(step.evidence)
        previous = None if step.previous is None else self._memory.load(step.previous)
        return self._memory.share(self._work.step(evidence, previous), step.answer)

    def save(self, message: SaveState) -> None:
        """Write the state, in parallel with the next frames."""
        assert self._work is not None  # begun
        self._writer.write(self._work.saved(), message.folder)

    def release(self, run: int) -> None:
        """Drop the layer and its memory."""
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
