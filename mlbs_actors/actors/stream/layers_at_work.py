"""The layers of a stream as its segmenter runs them: in the segmenter's process, or each in its own.

A layer begins in the segmenter's process and moves to its own when it has one. Waiting for that at a birth
could hold up the stream by seconds: a process needs a second or two of CPU time until it is ready, and in a
crowd dozens are born within seconds. A layer's results do not depend on where it runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.actors.ipc.channels import Channel, connect
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.layer_actor import LayerWork
from mlbs_actors.actors.stream.messages import AssignedProcess, LayerStep, SaveState
from mlbs_actors.actors.stream.saved_states import SavedLayer, layer_file
from mlbs_actors.config import Config
from mlbs_actors.messages import (
    BACKGROUND,
    FrameEvidence,
    LayerAppearance,
    LayerPosterior,
    Segmentation,
    readonly,
)
from mlbs_actors.state_file import read_state

__all__ = ["LayersAtWork", "SharedEvidence"]


@dataclass(frozen=True, slots=True)
class SharedEvidence:
    """A frame's evidence in the segmenter's process, and the references for its layers.

    Attributes
    ----------
    evidence : FrameEvidence
    previous : Segmentation or None
        Published result of the frame before.
    where_evidence, where_previous : Shared
        References to these; ``where_previous`` None if there is none.
    """

    evidence: FrameEvidence
    previous: Segmentation | None
    where_evidence: Shared[FrameEvidence]
    where_previous: Shared[Segmentation] | None


class LayersAtWork:
    """The segmenter's end of its layers.

    Parameters
    ----------
    parts : PartFactory
    memory : SharedMemory
        Of the segmenter's process.
    """

    def __init__(self, parts: PartFactory, config: Config, memory: SharedMemory) -> None:
        self._parts = parts
        self._config = config
        self._memory = memory
        self._here: dict[int, LayerWork] = {}
        self._elsewhere: dict[int, Channel] = {}

    def restore(self, layers: Sequence[SavedLayer], folder: Path) -> None:
        """Go back to a snapshot: to these layers, all in this process."""
        for own in layers:
            part = self._begin(own).part
            part.state = read_state(folder / layer_file(own.layer), type(part.state))

    def follow(self, evidence: FrameEvidence, assigned: Sequence[AssignedProcess]) -> None:
        """Create the layers that are new with a frame, then move some to their processes.

        Raises
        ------
        ChannelClosedError
            If such a process is gone.
        """
        for own in evidence.tracks:
            if own.layer not in self._here and own.layer not in self._elsewhere:
                self._begin(SavedLayer(own.layer, own.kind, -1))
        for one in assigned:
            channel = self._elsewhere[one.layer] = connect(one.address)
            channel.send(self._here.pop(one.layer).hand_over(one.state))

    def step(
        self, shared: SharedEvidence, answers: Mapping[int, Slot], appearance: Slot | None
    ) -> list[LayerPosterior]:
        """Have the layers process a frame in parallel; those of this process run one after the other.

        Parameters
        ----------
        shared : SharedEvidence
        answers : mapping of int to Slot
            For the posteriors of the frame's layers.
        appearance : Slot, optional
            For :meth:`appearance` of the background.

        Returns
        -------
        list of LayerPosterior
            In the order of the answers.
        """
        where = shared.where_evidence, shared.where_previous
        for layer, answer in answers.items():
            if layer in self._elsewhere:
                wanted = appearance if layer == BACKGROUND else None
                self._elsewhere[layer].send(LayerStep(*where, answer, wanted))
        posteriors = {
            layer: readonly(self._here[layer].step(shared.evidence, shared.previous))
            for layer in answers
            if layer in self._here
        }
        for layer in answers:
            if layer in self._elsewhere:
                posteriors[layer] = self._memory.load(self._elsewhere[layer].receive())
        return [posteriors[layer] for layer in answers]

    def appearance(self, layer: int, slot: Slot) -> Shared[LayerAppearance]:
        """Return the remembered colours of a layer whose last step requested them."""
        if layer in self._here:
            return self._here[layer].appearance(slot)
        appearance: Shared[LayerAppearance] = self._elsewhere[layer].receive()
        return appearance

    def retire(self, layers: Sequence[int]) -> None:
        """Drop layers; their processes stop serving."""
        for layer in layers:
            self._here.pop(layer, None)
            if layer in self._elsewhere:
                self._elsewhere.pop(layer).close()

    def save(self, message: SaveState) -> dict[str, object]:
        """Have the other processes write their layers' states; return the local ones by file."""
        for channel in self._elsewhere.values():
            channel.send(message)
        return {name: state for work in self._here.values() for name, state in work.saved().items()}

    def close(self) -> None:
        """Stop the other processes from serving."""
        for channel in self._elsewhere.values():
            channel.close()

    def _begin(self, own: SavedLayer) -> LayerWork:
        part = self._parts.layer(self._config, own.layer, own.kind)
        self._here[own.layer] = LayerWork(own, part, self._memory)
        return self._here[own.layer]
